"""Costs of collecting, loading and storing episodes.

Collection is compared with the bare environment, turn by turn in one run; loading and
sizes with Minari's own reader and writer on the same episodes.
"""

import os
import tracemalloc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import minari
import numpy as np
from minari.data_collector import EpisodeBuffer

from marl_mm.collectors.collect import collect
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.collectors.registry import everything
from marl_mm.datasets import cache
from marl_mm.datasets.arrays import EpisodeArrays, arrays_of, joined
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.hdf5 import FILE
from marl_mm.datasets.journal import Journal
from marl_mm.datasets.location import Location
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts, episode_seed
from marl_mm.episode import Episode
from marl_mm.progress import Advance, Bar, silent

TASK = "Reach-v0"
_TURNS = 3


def bench_data(
    episodes: int, workers: Sequence[int], load_steps: int, seed: int, bar: Bar
) -> dict[str, Any]:
    """Rates of collection, and costs of storage.

    Args:
        episodes: Episodes per turn and number of workers.
        workers: Numbers of processes to compare.
        load_steps: Steps of the dataset whose loading is timed.
        seed: Seed of the episodes.
        bar: Progress of each part.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        advance = bar("bench collection", (1 + _TURNS) * episodes * (1 + len(workers)))
        result, collected = bench_collection(
            episodes, workers, seed, folder / "journal", advance
        )
        advance = bar("bench storage", 4)
        with _cache_in(folder):
            result["storage"] = bench_storage(collected, load_steps, folder, advance)
    return result


@contextmanager
def _cache_in(folder: Path) -> Iterator[None]:
    """Have the cache in a folder, and not with the user's datasets."""
    before = os.environ.get(cache.FOLDER_VARIABLE)
    os.environ[cache.FOLDER_VARIABLE] = str(folder / "cache")
    try:
        yield
    finally:
        del os.environ[cache.FOLDER_VARIABLE]
        if before is not None:
            os.environ[cache.FOLDER_VARIABLE] = before


def bench_collection(
    episodes: int,
    workers: Sequence[int],
    seed: int,
    folder: Path,
    advance: Advance = silent,
) -> tuple[dict[str, Any], list[Episode]]:
    """Steps per second of random collection, medians of turns, and the episodes.

    Args:
        episodes: Number of episodes of 25 steps, per turn and number of workers.
        workers: Numbers of processes to compare.
        seed: Seed of the episodes.
        folder: Folder of the journal.
        advance: Called with the number of finished episodes.

    Returns:
        ``bare`` and each number of workers; processes are started before.
    """
    config = make_task(TASK)
    steps = episodes * config.max_steps
    core = EpisodeCore(config)
    pools = {number: Rollouts(config, number) for number in workers}
    policy = RandomPolicy(RandomConfig())
    rates: dict[str, list[float]] = {}
    collected: list[Episode] = []
    try:
        for turn in range(-1, _TURNS):  # the first one starts processes
            begin = perf_counter()
            _bare(core, episodes, seed)
            rates.setdefault("bare", []).append(steps / (perf_counter() - begin))
            advance(episodes, "bare")
            for number, rollouts in pools.items():
                rmtree(folder, ignore_errors=True)
                with Journal(folder) as journal:
                    begin = perf_counter()
                    collected = collect(
                        policy,
                        everything,
                        rollouts.completed,
                        steps,
                        seed,
                        keep_safe=journal.add,
                    ).episodes
                    seconds = perf_counter() - begin
                name = f"workers_{number}"
                rates.setdefault(name, []).append(steps / seconds)
                advance(episodes, f"{number} workers")
            if turn < 0:
                rates.clear()
    finally:
        core.close()
        for rollouts in pools.values():
            rollouts.close()
    result: dict[str, Any] = {
        "steps_per_second": {name: float(np.median(r)) for name, r in rates.items()}
    }
    for name in list(rates)[1:]:
        ratios = np.array(rates[name]) / np.array(rates["bare"])
        result[f"{name}_over_bare"] = float(np.median(ratios))
    return result, collected


def _bare(core: EpisodeCore, episodes: int, seed: int) -> None:
    """Run random episodes of the environment alone."""
    for number in range(episodes):
        rng = np.random.default_rng(episode_seed(seed, number, "collect"))
        core.reset(rng)
        for _ in range(core.task.max_steps):
            core.step(rng.uniform(core.task.layout.low, core.task.layout.high))


def bench_storage(
    episodes: Sequence[Episode], steps: int, folder: Path, advance: Advance = silent
) -> dict[str, Any]:
    """Time, memory and space of a dataset of so many steps.

    Args:
        episodes: Episodes that are cut to 10 steps, the length of successful ones, and
            repeated until there are enough.
        steps: Least number of steps.
        folder: Empty folder to write to. The cache has to be a new one, too.
        advance: Called with 1 after each of four parts of the work.

    Returns:
        Seconds to write, to load without and with the cache, and with Minari's reader;
        the most memory that loading takes [MB]; sizes on disk [MB], and that of
        Minari's writer for the same number of episodes.
    """
    arrays = _short(episodes, steps)
    location = Location("marl_mm/reach/bench-v0", folder / "bench")
    begin = perf_counter()
    write_dataset(location, arrays, Provenance(task=TASK, collector="random"))
    result: dict[str, Any] = {
        "steps": arrays.steps,
        "episodes": len(arrays),
        "write_s": perf_counter() - begin,
    }
    advance(1, "load")
    cache.clear()
    result["load_cold_s"], _ = _loaded(location)
    (entry,) = cache.entries()
    times, memories = zip(*(_loaded(location) for _ in range(_TURNS)), strict=True)
    result["load_cached_s"] = float(np.median(times))
    result["load_cached_memory_mb"] = float(np.median(memories))
    advance(1, "Minari's reader")
    begin = perf_counter()
    for _ in minari.MinariDataset(location.data).iterate_episodes():
        pass
    result["minari_read_s"] = perf_counter() - begin
    result["minari_over_cached"] = result["minari_read_s"] / result["load_cached_s"]
    advance(1, "Minari's writer")
    size = (location.data / FILE).stat().st_size / 1e6
    per_episode = _minari_size(arrays.select(range(min(300, len(arrays)))), folder)
    result["size_mb"] = size
    result["cache_mb"] = entry.size / 1e6
    result["minari_size_mb"] = per_episode * len(arrays)
    result["minari_size_over_ours"] = result["minari_size_mb"] / size
    advance(1, "")
    return result


def _short(episodes: Sequence[Episode], steps: int) -> EpisodeArrays:
    """The first ten steps of episodes, again and again."""
    length = 10
    ends = np.arange(length) == length - 1
    cut = [
        Episode(
            states=episode.states[: length + 1],
            actions=episode.actions[:length],
            rewards=episode.rewards[:length],
            terminated=ends,
            truncated=np.zeros(length, bool),
            info={key: values[:length] for key, values in episode.info.items()},
            seed=episode.seed,
            index=episode.index,
            source=episode.source,
            start=episode.start,
            layout=episode.layout,
        )
        for episode in episodes
        if len(episode) >= length
    ]
    once = arrays_of(cut, "marl_mm/reach/bench-v0")
    return joined([once] * -(-steps // once.steps))


def _loaded(location: Location) -> tuple[float, float]:
    """Seconds and largest memory [MB] of loading in a fresh process."""
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(_load, (location,))


def _load(location: Location) -> tuple[float, float]:
    begin = perf_counter()
    load_dataset(location).joint()
    seconds = perf_counter() - begin
    tracemalloc.start()
    load_dataset(location).joint()
    _, peak = tracemalloc.get_traced_memory()
    return seconds, peak / 1e6


def _minari_size(arrays: EpisodeArrays, folder: Path) -> float:
    """Megabytes per episode of the file that Minari's own writer makes."""
    from minari.dataset.minari_storage import MinariStorage

    from marl_mm.spaces import action_space, goal_observation_space

    layout = arrays.layout
    storage = MinariStorage.new(
        folder / "minari",
        observation_space=goal_observation_space(layout),
        action_space=action_space(layout),
        data_format="hdf5",
    )
    storage.update_episodes(
        EpisodeBuffer(
            observations={
                "observation": episode.states[:, layout.observation],
                "achieved_goal": episode.states[:, layout.achieved],
                "desired_goal": episode.states[:, layout.goal],
            },
            actions=episode.actions,
            rewards=episode.rewards,
            terminations=episode.terminated,
            truncations=episode.truncated,
            infos=episode.info,
        )
        for episode in (arrays.episode(i) for i in range(len(arrays)))
    )
    return (folder / "minari" / FILE).stat().st_size / 1e6 / len(arrays)
