"""Missing policies of the comparison of the engines, and the time they will take."""

from collections.abc import Sequence
from contextlib import closing
from itertools import product

import numpy as np

from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import make_task
from marl_mm.eval.bench.env import timed
from marl_mm.eval.studies.cells import kept_rows
from marl_mm.eval.studies.engines import EnginesOptions, cells_of
from marl_mm.eval.studies.policies import PolicyCell
from marl_mm.eval.tables import markdown_table
from marl_mm.progress import Bar
from marl_mm.sim.config import ENGINES

Line = list[str]
"""Texts of a line of a table."""

_STEPS = 10
"""Environment steps that are timed in each task, on each engine."""


def plan_engines(options: EnginesOptions, bar: Bar) -> str:
    """How many policies are missing, and hours if all goals take all steps; Markdown.

    Args:
        options: Settings of the comparison.
        bar: Factory of progress bars.

    Raises:
        UsageError: If an option makes no sense, or an engine lacks a task.
    """
    options.check_settings()

    def line(task: str, engine: str, left: int, every: int, seconds: float) -> Line:
        hours = f"{seconds / options.workers / 3600:.2f}"
        return [task, engine, f"{left} of {every}", *([] if options.small else [hours])]

    header = ["task", "engine", "policies missing"]
    header += [] if options.small else [f"hours at most, {options.workers} at once"]
    lines: list[Line] = []
    missing = total = 0
    longest = 0.0
    advance = bar("measuring", len(options.tasks) * len(ENGINES))
    for task, engine in product(options.tasks, ENGINES):
        cells = [cell for cell in cells_of(task, options) if cell.engine == engine]
        kept = kept_rows(cells, options.cells_folder)
        left = [cell for cell in cells if cell not in kept]
        seconds = 0.0 if options.small else _seconds(left)
        lines.append(line(task, engine, len(left), len(cells), seconds))
        missing, total = missing + len(left), total + len(cells)
        longest += seconds
        advance(1, f"{task} {engine}")
    return markdown_table(header, [*lines, line("all", "", missing, total, longest)])


def _seconds(cells: Sequence[PolicyCell]) -> float:
    """Longest time of cells of a task on an engine [s], measured on this machine."""
    if not cells:
        return 0.0
    task, rng = make_task(cells[0].task, cells[0].overrides), np.random.default_rng(0)
    with closing(EpisodeCore(task)) as core:
        timed(core, rng, 1)  # compiles
        per_step = timed(core, rng, _STEPS) / _STEPS
    return per_step * task.max_steps * sum(cell.goals for cell in cells)
