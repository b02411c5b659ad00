"""Seeds of a learner side by side in one process, on one core or on a GPU."""

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import torch

from marl_mm.algorithms.registry import ALGORITHMS, names
from marl_mm.algorithms.speed import (
    finish,
    matrix_products,
    small_networks,
)
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError
from marl_mm.eval.bench.matched import SIZES, with_settings
from marl_mm.progress import Advance, Bar, silent

ON_GPU = (1, 5, 16)
"""Numbers of seeds that learn side by side on a GPU."""

_WARM = 50
"""Most updates before those that are timed."""


def bench_gpu(updates: int, bar: Bar) -> dict[str, Any]:
    """Updates per second of all offline learners on a GPU, beside one core.

    Args:
        updates: Number of updates of each learner and number of seeds.
        bar: Factory of the progress bar.

    Raises:
        UsageError: If torch finds no GPU.
    """
    if not torch.cuda.is_available():
        raise UsageError("`gpu` is set, but torch finds no GPU: leave it out")
    learners = names(online=False)
    advance = bar("bench GPU", len(learners) * (1 + len(ON_GPU)) * updates)
    result: dict[str, Any] = {"gpu": torch.cuda.get_device_name(), "learners": {}}
    for name in learners:
        one_core = bench_side_by_side(name, updates, (1,), "cpu", advance)
        rates = bench_side_by_side(name, updates, ON_GPU, "cuda", advance)
        result["learners"][name] = {"core": one_core["1"], "gpu": rates}
    return result


@small_networks()
def bench_side_by_side(
    name: str,
    updates: int,
    seeds: Sequence[int],
    device: str,
    advance: Advance = silent,
) -> dict[str, float]:
    """Updates per second of all seeds together, by their number.

    Args:
        name: Name of an offline algorithm.
        updates: Number of updates of each seed.
        seeds: Numbers of seeds.
        device: "cuda", or "cpu" for one core.
        advance: Called with the number of finished updates.
    """
    arrays, judge = shipped_arrays(), make_task()
    config = with_settings(name, SIZES)
    make: Any = ALGORITHMS.get(name).learner
    rates = {}
    for count in seeds:
        learner = make(config, arrays, judge, range(count), device)
        with matrix_products("auto", device):
            _run(learner, min(updates, _WARM), device)
            begin = perf_counter()
            _run(learner, updates, device)
            rates[str(count)] = count * updates / (perf_counter() - begin)
        advance(updates, f"{name}, {count} on {device}")
    return rates


def _run(learner: Any, updates: int, device: str) -> None:
    for _ in range(updates):
        learner.update()
    finish(device)
