"""Time that cells of studies take, measured on this machine."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import make_task
from marl_mm.eval.bench.env import timed
from marl_mm.eval.tables import markdown_table

_STEPS = 10
"""Environment steps that are timed in each task."""


class GoalTimes:
    """Longest time of an episode by task and settings, each measured once."""

    def __init__(self) -> None:
        self._times: dict[str, float] = {}

    def __call__(self, name: str, overrides: Mapping[str, Any]) -> float:
        """Time of an episode that takes all steps [s].

        Args:
            name: Registered name of the task.
            overrides: Settings of the task that are replaced.
        """
        key = f"{name} {overrides}"
        if key not in self._times:
            task, rng = make_task(name, overrides), np.random.default_rng(0)
            with closing(EpisodeCore(task)) as core:
                timed(core, rng, 1)  # compiles
                self._times[key] = timed(core, rng, _STEPS) / _STEPS * task.max_steps
        return self._times[key]


def hours_table(
    head: Sequence[str],
    lines: Sequence[tuple[Sequence[str], int, int, float]],
    workers: int,
    measured: bool,
) -> str:
    """How much is missing, a line each and their sum, as Markdown.

    Args:
        head: Headings of the first columns.
        lines: Texts of the first columns, number that is missing, number in all, and
            the time that the missing ones take on one core at most [s].
        workers: Number of workers.
        measured: Whether times are known.
    """
    left = sum(left for _, left, _, _ in lines)
    every = sum(every for _, _, every, _ in lines)
    seconds = sum(seconds for *_, seconds in lines)
    total = ["all", *[""] * (len(head) - 1)], left, every, seconds
    table = [
        [*texts, f"{left} of {every}"]
        + ([f"{seconds / workers / 3600:.2f}"] if measured else [])
        for texts, left, every, seconds in (*lines, total)
    ]
    header = [*head, "missing"]
    header += [f"hours at most, {workers} at once"] if measured else []
    return markdown_table(header, table)
