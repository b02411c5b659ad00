"""Checks of hyper-parameters, and a type of theirs, for all algorithms."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal

from marl_mm.errors import UsageError

Precision = Literal["auto", "highest", "medium"]
"""Precision of products of float32 matrices; see ``speed.matrix_products``."""

LARGEST = 1_000_000_000
"""Largest whole number that a setting can be: beyond it there is no end."""

LARGEST_BATCH = 100_000
"""Largest number of transitions in a batch; 40 batches are drawn at once."""

MOST_FLOW_STEPS = 1_000
"""Largest number of Euler steps of a flow."""

_LARGEST = {
    "batch_size": LARGEST_BATCH,
    "flow_steps": MOST_FLOW_STEPS,
    "capacity": 10_000_000,
    **dict.fromkeys(("samples", "candidates", "rounds", "critics"), 1_000),
}
"""Largest numbers of settings for which ``LARGEST`` is too many."""

MOST_WEIGHTS = 100_000_000
"""Largest number of weights between hidden layers: 400 MB for each network, and twice
that for its optimiser."""


def check_ranges(
    config: Any,
    positive: Sequence[str],
    not_negative: Sequence[str] = (),
    shares: Sequence[str] = (),
) -> None:
    """Raise for the first field outside of its range, or hidden layers of no width.

    Batches and hidden layers have largest sizes. Arguments are those of
    ``check_numbers``, of a dataclass that has ``hidden`` as well.

    Raises:
        UsageError: Naming the field, its value and its range.
    """
    check_numbers(config, positive, not_negative, shares)
    if not config.hidden or min(config.hidden) < 1:
        raise UsageError(f"hidden is {config.hidden}, expected positive widths")
    weights = sum(before * after for before, after in pairwise((1, *config.hidden, 1)))
    if weights > MOST_WEIGHTS:
        raise UsageError(
            f"hidden is {config.hidden}, expected at most {MOST_WEIGHTS:,} weights "
            "between layers"
        )


def check_numbers(
    config: Any,
    positive: Sequence[str],
    not_negative: Sequence[str] = (),
    shares: Sequence[str] = (),
) -> None:
    """Raise for the first field outside of its range.

    Whole numbers are at most ``LARGEST``.

    Args:
        config: A dataclass with these fields.
        positive: Fields above 0, and finite.
        not_negative: Fields of 0 or more, and finite.
        shares: Fields from 0 to 1.

    Raises:
        UsageError: Naming the field, its value and its range.
    """
    for name in (*positive, *not_negative):
        most = _LARGEST.get(name, LARGEST)
        value = getattr(config, name)
        if isinstance(value, int) and value > most:
            raise UsageError(f"{name} is {value}, expected at most {most:,}")
    for name in positive:
        if not 0 < getattr(config, name) < math.inf:
            raise UsageError(f"{name} is {getattr(config, name)}, expected > 0, finite")
    for name in not_negative:
        if not 0 <= getattr(config, name) < math.inf:
            raise UsageError(
                f"{name} is {getattr(config, name)}, expected >= 0, finite"
            )
    for name in shares:
        if not 0 <= getattr(config, name) <= 1:
            raise UsageError(f"{name} is {getattr(config, name)}, expected 0 to 1")
