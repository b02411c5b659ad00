"""Intervals that tasks draw from."""

import math
from typing import Any

from marl_mm.errors import UsageError

Interval = tuple[float, float]


def check_intervals(config: Any, *fields: str, of: str = "") -> None:
    """Raise for an interval whose ends are in the wrong order, or not finite.

    Args:
        config: Config with the intervals.
        fields: Names of their fields.
        of: Beginning of the fields' names in messages, such as "wall.".

    Raises:
        UsageError: Naming the field.
    """
    for name in fields:
        low, high = getattr(config, name)
        if not -math.inf < low <= high < math.inf:
            raise UsageError(
                f"{of}{name} is {low:g} to {high:g}, expected the smaller first, "
                "both finite"
            )


def check_within(name: str, interval: Interval, of: Interval, why: str) -> None:
    """Raise for an interval that is not within another one.

    Args:
        name: What the interval is of, such as "wall.z".
        interval: The interval [m].
        of: The interval that it has to be within [m].
        why: Reason for that, such as "what the hand reaches".

    Raises:
        UsageError: Naming it, and both intervals.
    """
    (low, high), (least, most) = interval, of
    if not least <= low <= high <= most:
        raise UsageError(
            f"{name} is {low:g} to {high:g} m, expected within {least:g} to {most:g}: "
            f"{why}"
        )
