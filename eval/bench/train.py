"""Costs of learning: online and offline learners beside others', and many seeds."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch

from marl_mm.algorithms.registry import names
from marl_mm.errors import UsageError
from marl_mm.eval.bench import d3rlpy_reference
from marl_mm.eval.bench.acting import bench_acting
from marl_mm.eval.bench.d3rlpy_process import learners_of
from marl_mm.eval.bench.offline import bench_offline, bench_seeds
from marl_mm.eval.bench.online import bench_online, bench_success
from marl_mm.eval.bench.side_by_side import bench_gpu, bench_side_by_side
from marl_mm.progress import Bar
from marl_mm.runs.settings import check_positive

_TURN = 100
"""Updates of a turn; their number is rounded up to whole turns."""


_LONGER = 10
"""Factor of the updates of each seed of a command, which takes seconds to begin."""


def bench_train(
    updates: int,
    env_steps: int,
    seeds: int,
    seed: int,
    d3rlpy: Path | None,
    bar: Bar,
) -> dict[str, Any]:
    """Updates per second of all learners, and time to act; success online; many seeds.

    Stable-Baselines3 takes part if it is installed. Seeds learn side by side on a core,
    and, with few updates, on a GPU if there is one.

    Args:
        updates: Gradient updates of each algorithm.
        env_steps: Environment steps of ours and Stable-Baselines3's for the comparison
            of success; 0 leaves it out.
        seeds: Seeds of one command, compared with a single one; 1 leaves it out.
        seed: Seed of networks and episodes.
        d3rlpy: Python of an environment with d3rlpy, which then takes part.
        bar: Progress of each part.

    Raises:
        UsageError: If a number makes no sense, or d3rlpy does not work.
    """
    check_positive(updates=updates, seeds=seeds)
    if env_steps < 0:
        raise UsageError(f"`env_steps` is {env_steps}, expected >= 0")
    if d3rlpy is not None:
        with learners_of(d3rlpy):  # before minutes of the others
            pass
    sb3 = find_spec("stable_baselines3") is not None
    updates = -(-updates // _TURN) * _TURN
    advance = bar("bench online", (4 if sb3 else 3) * updates)
    result = bench_online(updates, seed, sb3, advance=advance)
    if env_steps > 0:
        advance = bar("bench success", env_steps * (2 if sb3 else 1))
        result["success"] = bench_success(env_steps, seed, sb3=sb3, advance=advance)
    result["offline"] = bench_offline(updates, seed, d3rlpy, bar)
    if seeds > 1:
        advance = bar("bench seeds", 2 * (1 + seeds))
        result["seeds"] = bench_seeds(_LONGER * updates, seeds, advance=advance)
    advance = bar("bench side by side", 2 * updates)
    result["side_by_side"] = bench_side_by_side(
        "td3-bc", updates, (1, 5), "cpu", advance
    )
    advance = bar("bench acting", len(names(online=False)))
    result["acting_ms"] = bench_acting(d3rlpy_reference.HIDDEN, seed, advance=advance)
    if torch.cuda.is_available():
        result["gpu"] = bench_gpu(_TURN, bar)
    return result
