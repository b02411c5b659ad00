"""Offline learning: updates per second of all learners beside others'; several seeds.

All learn from the dataset that ships, with batches of 256 and two layers of 256, and
take turns, so that a noisy machine is as noisy for each.
"""

import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from time import perf_counter
from typing import Any

import numpy as np
import psutil
import torch

from marl_mm.algorithms.registry import ALGORITHMS, PAPER
from marl_mm.algorithms.speed import matrix_products, small_networks
from marl_mm.algorithms.td3_bc import Td3Bc
from marl_mm.algorithms.td3_bc_config import Td3BcConfig
from marl_mm.datasets.location import SHIPPED
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.envs.registry import make_task
from marl_mm.errors import MarlMmError
from marl_mm.eval.bench import d3rlpy_reference
from marl_mm.eval.bench.d3rlpy_process import Rate, learners_of, named
from marl_mm.eval.bench.matched import SIZES, learner, matched, with_settings
from marl_mm.eval.bench.td3_bc_reference import PlainTd3Bc
from marl_mm.progress import Advance, Bar, silent
from marl_mm.workers import available_cores

AUTHORS = "td3-bc, its authors' restated"
AUTHORS_AUTO = f"{AUTHORS}, --precision auto"
PLAIN = "td3-bc, no more than theirs"
PLAIN_HIGHEST = f"{PLAIN}, --precision highest"

THREADS = (1, 2)
"""Numbers of threads that updates are timed with."""

_TURN = 50
"""Updates until it is another's turn."""

_LOOK_EVERY = 0.5
"""Time between measurements of a command's memory [s]."""


@small_networks()
def bench_offline(
    updates: int, seed: int, d3rlpy: Path | None, bar: Bar
) -> dict[str, Any]:
    """Updates per second of each learner, and ours over others'.

    Args:
        updates: Number of updates of each algorithm and number of threads, in turns.
        seed: Seed of networks and batches.
        d3rlpy: Python of an environment with d3rlpy, which then takes part.
        bar: Factory of the progress bar.

    Raises:
        UsageError: If that Python is not there, or has no d3rlpy.
    """
    each = min(_TURN, updates)
    with ExitStack() as stack:
        theirs = stack.enter_context(learners_of(d3rlpy)) if d3rlpy else {}
        learners, references = _learners(seed)
        learners |= theirs
        keys = [(threads, name) for threads in THREADS for name in learners]
        advance = bar("bench offline", len(keys) * updates)
        rates: dict[tuple[int, str], list[float]] = {key: [] for key in keys}
        for turn in range(-1, updates // each):
            for threads, name in keys:
                rate = learners[name](each, threads)
                if turn >= 0:  # the first one warms caches
                    rates[threads, name].append(rate)
                    advance(each, name)
    return {
        f"threads_{threads}": {
            name: {"updates_per_second": float(np.median(rates[threads, name]))}
            | _over(rates, threads, name, references.get(name))
            for name in learners
        }
        for threads in THREADS
    }


def _over(
    rates: Mapping[tuple[int, str], list[float]],
    threads: int,
    name: str,
    reference: str | None,
) -> dict[str, Any]:
    """Median of the ratios of turns to a reference's; empty without."""
    if (threads, reference) not in rates:
        return {}
    assert reference is not None
    ratios = np.array(rates[threads, name]) / np.array(rates[threads, reference])
    return {"reference": reference, "over_reference": float(np.median(ratios))}


def bench_seeds(
    updates: int, seeds: int, turns: int = 2, advance: Advance = silent
) -> dict[str, float]:
    """The command ``marl-mm train td3-bc`` with several seeds, over one, in turns.

    Args:
        updates: Number of updates of each seed; the start of a command counts too.
        seeds: Number of seeds.
        turns: Number of turns of each command; the shortest counts.
        advance: Called with the number of trained seeds.

    Returns:
        Seconds of each command, what several seeds cost over one, and
        the most memory of all processes [MiB], where shared memory counts once.
    """
    walls: dict[int, list[float]] = {1: [], seeds: []}
    memory = dict.fromkeys(walls, 0.0)
    for _ in range(turns):
        for count, seconds in walls.items():
            with TemporaryDirectory() as folder:
                wall, most = _train(updates, count, folder)
            seconds.append(wall)
            memory[count] = max(memory[count], most)
            advance(count, f"{count} seeds")
    single, several = min(walls[1]), min(walls[seeds])
    return {
        "seeds": seeds,
        "cores": available_cores(),
        "one_s": single,
        "several_s": several,
        "cost_over_one": several / single,
        "one_memory_mib": memory[1],
        "several_memory_mib": memory[seeds],
    }


def _train(updates: int, seeds: int, folder: str) -> tuple[float, float]:
    """Seconds that the command took, and the most memory of its processes [MiB]."""
    hidden = " ".join(map(str, d3rlpy_reference.HIDDEN))
    words = (
        f"-m marl_mm train td3-bc --dataset {SHIPPED} --updates {updates} "
        f"--hidden {hidden} --curve-every {updates} --curve-episodes 1 "
        f"--eval-episodes 2 --out {folder} --overwrite --seeds"
    ).split()
    command = [sys.executable, *words, *map(str, range(seeds))]
    begin, most = perf_counter(), 0.0
    quiet = subprocess.DEVNULL
    with (
        TemporaryFile("w+", encoding="utf-8") as errors,
        subprocess.Popen(command, stdout=quiet, stderr=errors) as job,
    ):
        while job.poll() is None:
            most = max(most, _memory(psutil.Process(job.pid)))
            with suppress(subprocess.TimeoutExpired):
                job.wait(_LOOK_EVERY)
        wall = perf_counter() - begin
        if job.returncode:
            errors.seek(0)
            complaint = errors.read().strip()[-200:]
            raise MarlMmError(f"{' '.join(command)} failed: {complaint}")
    return wall, most


def _memory(process: psutil.Process) -> float:
    """Proportional set size of a process and its children [MiB]."""
    total = 0
    with suppress(psutil.NoSuchProcess):  # it may end meanwhile
        for member in (process, *process.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                total += member.memory_full_info().pss
    return total / 2**20


def _learners(seed: int) -> tuple[dict[str, Rate], dict[str, str]]:
    """What is timed beside d3rlpy's, and what each is compared with."""
    arrays, rewards = shipped_arrays(), make_task()
    plain, auto = plain_config(), matrix_products("auto")  # as a decorator
    steps: dict[str, Callable[[], object]] = {
        AUTHORS: PlainTd3Bc(arrays, plain, seed).update,
        AUTHORS_AUTO: auto(PlainTd3Bc(arrays, plain, seed).update),
        PLAIN: auto(Td3Bc(plain, arrays, rewards, [seed]).update),
        PLAIN_HIGHEST: Td3Bc(plain, arrays, rewards, [seed]).update,
    }
    references = dict.fromkeys((AUTHORS_AUTO, PLAIN, PLAIN_HIGHEST), AUTHORS)
    for name in d3rlpy_reference.NAMES:
        label = f"{name}, as d3rlpy's"
        steps[label] = auto(learner(name, matched(name), arrays, rewards, seed).update)
        references[label] = named(name)
    for name in ALGORITHMS.names():
        if not ALGORITHMS.get(name).online:
            config = with_settings(name, SIZES)
            steps[name] = auto(learner(name, config, arrays, rewards, seed).update)
    return {name: _timed(update) for name, update in steps.items()}, references


def _timed(update: Callable[[], object]) -> Rate:
    def rate(updates: int, threads: int) -> float:
        torch.set_num_threads(threads)
        return _rate(update, updates)

    return rate


def plain_config() -> Td3BcConfig:
    """Our settings that match the authors' code."""
    config = with_settings("td3-bc", SIZES, PAPER)
    assert isinstance(config, Td3BcConfig)
    return config


def _rate(update: Callable[[], object], updates: int) -> float:
    begin = perf_counter()
    for _ in range(updates):
        update()
    return updates / (perf_counter() - begin)
