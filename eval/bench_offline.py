"""Offline learning: updates per second beside the authors' TD3+BC, seeds, memory.

All learn from the dataset that ships, with batches of 256 and two layers of 256, and
take turns, so that a noisy machine is as noisy for each.
"""

import resource
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from time import perf_counter
from typing import Any

import numpy as np
import torch

from marl_mm.algorithms.mabc import Mabc, MabcConfig
from marl_mm.algorithms.matd3_bc import Matd3Bc, Matd3BcConfig
from marl_mm.algorithms.presets import offline_preset
from marl_mm.algorithms.td3_bc import Td3Bc, Td3BcConfig
from marl_mm.datasets.arrays import load_arrays
from marl_mm.datasets.shipped import ARRAYS
from marl_mm.envs.config import reach_config
from marl_mm.envs.terms import judge
from marl_mm.eval.td3_bc_reference import PlainTd3Bc
from marl_mm.progress import Advance, silent
from marl_mm.workers import Workers

AUTHORS = "td3-bc, its authors'"
PLAIN = "td3-bc, no more than theirs"

HIDDEN = (256, 256)

LEARNERS = 5
"""How many are timed."""

_TURN = 100
"""Updates until it is another's turn."""


def bench_offline(
    updates: int, seed: int = 0, seeds: int = 3, advance: Advance = silent
) -> dict[str, Any]:
    """Updates per second of each, and ours over the authors'.

    Args:
        updates: Of each algorithm, in turns, and of each seed.
        seed: Of networks and batches.
        seeds: How many to train at once.
        advance: Told the updates.

    Returns:
        Medians and ratios; the throughput of several seeds, each a process of one
        thread, over that of one; and a process's largest memory [MB].
    """
    torch.set_num_threads(1)
    learners = _learners(seed)
    rates: dict[str, list[float]] = {name: [] for name in learners}
    turns = max(1, updates // _TURN)
    for turn in range(-1, turns):
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
        "seeds": _several(seeds, turns, advance),
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _learners(seed: int) -> dict[str, Callable[[], object]]:
    arrays, rewards = load_arrays(ARRAYS), partial(judge, config=reach_config())
    tuned, plain = Td3BcConfig(hidden=HIDDEN), plain_config()
    others = Matd3BcConfig(hidden=HIDDEN)
    cloning = MabcConfig(hidden=HIDDEN)
    return {
        AUTHORS: PlainTd3Bc(arrays, plain, seed).update,
        PLAIN: Td3Bc(plain, arrays, rewards, [seed]).update,
        "td3-bc": Td3Bc(tuned, arrays, rewards, [seed]).update,
        "matd3-bc": Matd3Bc(others, arrays, rewards, [seed]).update,
        "mabc": Mabc(cloning, arrays, rewards, [seed]).update,
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


def _several(seeds: int, turns: int, advance: Advance) -> dict[str, float]:
    """Processes that learn at once, over one alone, in turns."""
    barrier = get_context("spawn").Barrier(seeds)
    ratios, memories = [], []
    with Workers(seeds, _begin_learner, (barrier,)) as pool:
        for turn in range(-1, turns):
            together = list(pool.map(_together, [_TURN] * seeds, ahead=1))
            (alone,) = pool.map(_alone, [_TURN])
            if turn >= 0:
                ratios.append(sum(rate for rate, _ in together) / alone[0])
                memories.append(sum(memory for _, memory in together))
                advance(_TURN, f"{seeds} seeds")
    return {
        "seeds": seeds,
        "throughput_over_one": float(np.median(ratios)),
        "memory_mb": max(memories),
    }


_learner: tuple[Callable[[], object], Any]
"""A process's update, and where it waits for the others."""


def _begin_learner(barrier: Any) -> None:
    global _learner
    torch.set_num_threads(1)
    arrays, rewards = load_arrays(ARRAYS), partial(judge, config=reach_config())
    learner = Td3Bc(Td3BcConfig(hidden=HIDDEN), arrays, rewards, [0])
    _learner = learner.update, barrier


def _together(updates: int) -> tuple[float, float]:
    _learner[1].wait()  # for the others
    return _alone(updates)


def _alone(updates: int) -> tuple[float, float]:
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return _rate(_learner[0], updates), memory
