"""Missing policies of the comparisons that train nothing, and the time they take."""

from collections.abc import Container, Mapping, Sequence
from itertools import product
from pathlib import Path

from marl_mm.eval.studies.cells import kept_rows, missing_groups
from marl_mm.eval.studies.coordination import CoordinationOptions
from marl_mm.eval.studies.coordination import groups_of as teams_by_path
from marl_mm.eval.studies.cost import GoalTimes, hours_table
from marl_mm.eval.studies.engines import EnginesOptions, cells_of, groups_of, rows_path
from marl_mm.eval.studies.options import PolicyOptions
from marl_mm.eval.studies.policies import PolicyCell
from marl_mm.progress import Bar
from marl_mm.sim.config import ENGINES, Engine


def plan_engines(options: EnginesOptions, bar: Bar) -> str:
    """How many policies are missing, and hours if all goals take all steps; Markdown.

    Args:
        options: Settings of the comparison.
        bar: Factory of progress bars.

    Raises:
        UsageError: If an option makes no sense, or an engine lacks a task.
    """
    options.check_settings()
    missing = missing_groups(groups_of(options), options.overwrite)
    groups = {
        (task, engine): [c for c in cells_of(task, options) if c.engine == engine]
        for task, engine in product(options.tasks, ENGINES)
    }
    there = {key for key in groups if rows_path(options, key[0]) not in missing}
    return _plan(options, options.cells_folder, groups, there, bar)


def plan_coordination(options: CoordinationOptions, bar: Bar) -> str:
    """Likewise, of the comparison of teams."""
    options.check_settings()
    every = teams_by_path(options)
    missing = missing_groups(every, options.overwrite)
    groups = {(c[0].task, c[0].engine): c for c in every.values()}
    there = {(c[0].task, c[0].engine) for p, c in every.items() if p not in missing}
    return _plan(options, options.cells_folder, groups, there, bar)


def _plan(
    options: PolicyOptions,
    folder: Path,
    groups: Mapping[tuple[str, Engine], Sequence[PolicyCell]],
    there: Container[tuple[str, Engine]],
    bar: Bar,
) -> str:
    """A row for each task and engine, and its cells that have no rows in a folder.

    Args:
        options: Settings of the comparison.
        folder: Folder of the cells' rows.
        groups: Cells by task and engine.
        there: Tasks and engines whose rows are in the results.
        bar: Factory of progress bars.
    """
    lines, goal_times = [], GoalTimes()
    advance = bar("measuring", len(groups))
    for words, cells in groups.items():
        kept = cells if words in there else kept_rows(cells, folder)
        left = [cell for cell in cells if cell not in kept]
        seconds = 0.0
        if left and not options.small:
            per_goal = goal_times(left[0].task, left[0].overrides)
            seconds = per_goal * sum(cell.goals for cell in left)
        lines.append((words, len(left), len(cells), seconds))
        advance(1, " ".join(words))
    return hours_table(("task", "engine"), lines, options.workers, not options.small)
