"""Checks of hyper-parameters, and a type of theirs, for all algorithms."""

import math
from collections.abc import Sequence
from typing import Any, Literal

from marl_mm.errors import UsageError

Precision = Literal["auto", "highest", "medium"]
"""Precision of products of float32 matrices; see ``speed.matrix_products``."""


def check_ranges(
    config: Any,
    positive: Sequence[str],
    not_negative: Sequence[str] = (),
    shares: Sequence[str] = (),
) -> None:
    """Raise for the first field outside of its range, or hidden layers of no width.

    Args:
        config: A dataclass with these fields and ``hidden``.
        positive: Fields above 0, and finite.
        not_negative: Fields of 0 or more, and finite.
        shares: Fields from 0 to 1.

    Raises:
        UsageError: Naming the field, its value and its range.
    """
    for name in positive:
        if not 0 < getattr(config, name) < math.inf:
            raise UsageError(f"{name} is {getattr(config, name)}, expected > 0")
    for name in not_negative:
        if not 0 <= getattr(config, name) < math.inf:
            raise UsageError(f"{name} is {getattr(config, name)}, expected >= 0")
    for name in shares:
        if not 0 <= getattr(config, name) <= 1:
            raise UsageError(f"{name} is {getattr(config, name)}, expected 0 to 1")
    if not config.hidden or min(config.hidden) < 1:
        raise UsageError(f"hidden is {config.hidden}, expected positive widths")
