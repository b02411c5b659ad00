"""Rows in groups, and their columns as arrays."""

from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from marl_mm.errors import MarlMmError

R = TypeVar("R", bound=Mapping[str, Any])


def grouped(rows: Sequence[R], *keys: str) -> dict[Any, list[R]]:
    """Rows by the value of a key, or by the tuple of values of several.

    Groups are in the order in which they first occur.
    """
    groups: dict[Any, list[R]] = {}
    value = itemgetter(*keys)
    for row in rows:
        groups.setdefault(value(row), []).append(row)
    return groups


def by_goal(rows: Sequence[Mapping[str, Any]], name: str) -> NDArray[np.float64]:
    """A column in the order of seeds and goals, to be paired with other rows'.

    Raises:
        MarlMmError: If seeds have other goals, or one twice.
    """
    ordered = sorted(rows, key=itemgetter("seed", "goal"))
    goals = [[row["goal"] for row in own] for own in grouped(ordered, "seed").values()]
    if any(own != goals[0] or len({*own}) < len(own) for own in goals):
        raise MarlMmError(
            "rows are damaged: their seeds do not all have the same goals, each once"
        )
    return np.array([row[name] for row in ordered], dtype=float)


def mean_of(rows: Sequence[Mapping[str, Any]], name: str) -> float:
    """Mean of a column."""
    return float(np.mean([row[name] for row in rows]))


def engine_in(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Column ``engine`` of a row that sums up these; none where they name no engine."""
    return {"engine": rows[0]["engine"]} if rows[0].get("engine") else {}
