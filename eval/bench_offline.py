"""Offline learning: updates per second beside the authors' TD3+BC; several seeds.

All learn from the dataset that ships, with batches of 256 and two layers of 256, and
take turns, so that a noisy machine is as noisy for each.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from marl_mm.algorithms.mabc import Mabc, MabcConfig
from marl_mm.algorithms.matd3_bc import Matd3Bc, Matd3BcConfig
from marl_mm.algorithms.presets import offline_preset
from marl_mm.algorithms.speed import matrix_products, prepare_for_small_networks
from marl_mm.algorithms.td3_bc import Td3Bc, Td3BcConfig
from marl_mm.datasets.arrays import load_arrays
from marl_mm.datasets.location import SHIPPED
from marl_mm.datasets.shipped import ARRAYS
from marl_mm.envs.config import reach_config
from marl_mm.envs.terms import judge
from marl_mm.errors import MarlMmError
from marl_mm.eval.td3_bc_reference import PlainTd3Bc
from marl_mm.progress import Advance, silent

AUTHORS = "td3-bc, its authors'"
PLAIN = "td3-bc, no more than theirs"
PLAIN_HIGHEST = f"{PLAIN}, --precision highest"
HIGHEST = "td3-bc, --precision highest"

HIDDEN = (256, 256)

LEARNERS = 7
"""How many are timed."""

_TURN = 100
"""Updates until it is another's turn."""


def bench_offline(
    updates: int, seed: int = 0, advance: Advance = silent
) -> dict[str, Any]:
    """Updates per second of each, and ours over the authors'.

    Args:
        updates: Of each algorithm, in turns.
        seed: Of networks and batches.
        advance: Told the updates.
    """
    prepare_for_small_networks()
    learners = _learners(seed)
    rates: dict[str, list[float]] = {name: [] for name in learners}
    for turn in range(-1, max(1, updates // _TURN)):
        for name, update in learners.items():
            rate = _rate(update, _TURN)
            if turn >= 0:  # the first one warms caches
                rates[name].append(rate)
                advance(_TURN, name)
    theirs = np.array(rates[AUTHORS])
    return {
        "updates_per_second": {name: float(np.median(r)) for name, r in rates.items()},
        "over_authors": {
            name: float(np.median(np.array(rates[name]) / theirs))
            for name in rates
            if name != AUTHORS
        },
    }


def bench_seeds(
    updates: int, seeds: int, turns: int = 2, advance: Advance = silent
) -> dict[str, float]:
    """The command ``marl-mm train td3-bc`` with several seeds, over one, in turns.

    Args:
        updates: Of each seed; the time that a command takes to begin counts, too.
        seeds: How many.
        turns: Of each; the shortest counts.
        advance: Told the seeds that are trained.

    Returns:
        Seconds of each, how many times the throughput of one several have, and the
        largest process's memory [MB].
    """
    walls: dict[int, list[float]] = {1: [], seeds: []}
    memory = 0.0
    for _ in range(turns):
        for count, found in walls.items():
            with TemporaryDirectory() as folder:
                wall, largest = _train(updates, count, folder)
            found.append(wall)
            memory = max(memory, largest)
            advance(count, f"{count} seeds")
    one, several = min(walls[1]), min(walls[seeds])
    return {
        "seeds": seeds,
        "cores": len(os.sched_getaffinity(0)),
        "one_s": one,
        "several_s": several,
        "throughput_over_one": seeds * one / several,
        "largest_process_mb": memory,
    }


def _train(updates: int, seeds: int, folder: str) -> tuple[float, float]:
    """Seconds that the command took, and its largest process [MB]."""
    words = (
        f"-m marl_mm train td3-bc --dataset {SHIPPED} --updates {updates} --hidden "
        f"{' '.join(map(str, HIDDEN))} --curve-every {updates} --curve-episodes 1 "
        f"--eval-episodes 2 --out {folder} --overwrite --seeds"
    ).split()
    command = [sys.executable, *words, *map(str, range(seeds))]
    begin = perf_counter()
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=quiet, stderr=subprocess.PIPE) as job:
        assert job.stderr is not None
        complaint = job.stderr.read().decode()
        _, status, usage = os.wait4(job.pid, 0)
        job.returncode = os.waitstatus_to_exitcode(status)
    if job.returncode:
        raise MarlMmError(f"{' '.join(command)} failed: {complaint.strip()[-200:]}")
    return perf_counter() - begin, usage.ru_maxrss / 1024


def _learners(seed: int) -> dict[str, Callable[[], object]]:
    arrays, rewards = load_arrays(ARRAYS), partial(judge, config=reach_config())
    tuned, plain = Td3BcConfig(hidden=HIDDEN), plain_config()
    others = Matd3BcConfig(hidden=HIDDEN)
    cloning = MabcConfig(hidden=HIDDEN)
    auto = matrix_products("auto")  # as a decorator
    return {
        AUTHORS: PlainTd3Bc(arrays, plain, seed).update,
        PLAIN: auto(Td3Bc(plain, arrays, rewards, [seed]).update),
        PLAIN_HIGHEST: Td3Bc(plain, arrays, rewards, [seed]).update,
        "td3-bc": auto(Td3Bc(tuned, arrays, rewards, [seed]).update),
        HIGHEST: Td3Bc(tuned, arrays, rewards, [seed]).update,
        "matd3-bc": auto(Matd3Bc(others, arrays, rewards, [seed]).update),
        "mabc": auto(Mabc(cloning, arrays, rewards, [seed]).update),
    }


def plain_config() -> Td3BcConfig:
    """What the authors' code does, of ours."""
    config = offline_preset("td3-bc", "paper")
    assert isinstance(config, Td3BcConfig)
    return replace(config, hidden=HIDDEN)


def _rate(update: Callable[[], object], updates: int) -> float:
    begin = perf_counter()
    for _ in range(updates):
        update()
    return updates / (perf_counter() - begin)
