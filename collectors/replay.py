"""Replay: whether an episode's seed and actions repeat it to the last bit."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from marl_mm.datasets.dataset import Dataset
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import EpisodePlan, run_episode
from marl_mm.envs.task import Task
from marl_mm.episode import Episode
from marl_mm.errors import DatasetError
from marl_mm.layout import Layout
from marl_mm.layout_diff import refuse_other_layout
from marl_mm.progress import Advance, silent
from marl_mm.sim.config import as_recorded
from marl_mm.sim.world import check_engine
from marl_mm.workers import Workers


class ReplayPolicy:
    """Policy that repeats the actions of an episode.

    Args:
        episode: The episode.
    """

    def __init__(self, episode: Episode) -> None:
        self.name = episode.source
        self._actions = episode.actions

    def describe(self) -> dict[str, Any]:
        """No settings."""
        return {}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Start with the first action."""
        self._step = 0

    def act(self, state: np.ndarray) -> np.ndarray:
        """The next action; the last one is repeated."""
        action = self._actions[min(self._step, len(self._actions) - 1)]
        self._step += 1
        return np.asarray(action)


def replay(dataset: Dataset, workers: int = 1) -> Iterator[str | None]:
    """Run each episode again in the environment that it was collected in.

    Returns:
        For each episode in order, a text about the first difference, or None.

    Raises:
        DatasetError: If episodes were imported, so that their origin is unknown.
        UsageError: If the engine that simulated them is not installed.
    """
    arrays, origins = dataset.arrays, dataset.provenance.origins
    items = []
    for number in range(len(arrays)):
        origin = str(arrays.origins[number])
        about = origins.get(origin)
        if about is None or about.collector is None or about.task is None:
            raise DatasetError(
                f"episode {number} comes from {origin!r}, which was imported: without "
                "its seed and settings it cannot be replayed"
            )
        task = make_task(about.task, as_recorded(about.overrides))
        check_engine(task.simulation.engine, "; no other engine repeats its episodes")
        refuse_other_layout(f"episode {number}", arrays.layout, about.task, task.layout)
        items.append((task, arrays.episode(number)))
    return _differences(items, workers)


def _differences(
    items: list[tuple[Task, Episode]], workers: int
) -> Iterator[str | None]:
    try:
        with Workers(workers) as pool:
            yield from pool.map(_difference, items)
    finally:
        while _cores:
            _cores.popitem()[1].close()


_cores: dict[str, EpisodeCore] = {}
"""Environments of this process, by task."""


def _difference(item: tuple[Task, Episode]) -> str | None:
    task, episode = item
    key = f"{id(type(task))} {task!r}"
    if key not in _cores:
        _cores[key] = EpisodeCore(task)
    plan = EpisodePlan(episode.index, episode.seed)
    again = run_episode(_cores[key], ReplayPolicy(episode), plan)
    if again.info.keys() != episode.info.keys():
        differ = again.info.keys() ^ episode.info.keys()
        return f"only one of replay and file has {', '.join(sorted(differ))}"
    pairs = {
        name: (getattr(again, name), getattr(episode, name))
        for name in ("states", "actions", "rewards", "terminated", "truncated", "start")
    }
    pairs |= {
        f"info {key}": (values, _like(values, episode.info[key]))
        for key, values in again.info.items()
    }
    for name, (here, there) in pairs.items():
        if here.dtype != there.dtype:
            return f"{name} is {here.dtype} in the replay, {there.dtype} in the file"
        if here.shape != there.shape or here.tobytes() != there.tobytes():
            return f"{name} differ: {_first_difference(here, there)}"
    return None


def _like(values: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The others in the values' type, if that loses nothing: a mix may widen it."""
    with np.errstate(invalid="ignore"):
        cast = others.astype(values.dtype)
    return cast if np.array_equal(cast, others) else others


def _first_difference(here: np.ndarray, there: np.ndarray) -> str:
    if here.shape != there.shape:
        return f"shape {here.shape} in the replay, {there.shape} in the file"
    bits = (side.view(np.uint8).reshape(*side.shape, -1) for side in (here, there))
    same = np.equal(*bits).all(axis=-1)
    where = tuple(np.argwhere(~same)[0].tolist())
    return f"at {list(where)} {here[where]} in the replay, {there[where]} in the file"


def problems(
    dataset: Dataset, workers: int = 1, advance: Advance = silent
) -> list[str]:
    """Episodes that their seeds and actions do not give again, and what differs.

    Args:
        dataset: Its episodes are run again.
        workers: Processes.
        advance: Called after each episode.

    Raises:
        DatasetError: If the dataset does not say where its episodes come from.
    """
    lines = []
    for number, difference in enumerate(replay(dataset, workers)):
        advance(1, "")
        if difference is not None:
            lines.append(f"episode {number}: {difference}")
    return lines
