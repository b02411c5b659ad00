"""Missing policies of the comparison of the engines, and the time they will take."""

from itertools import product

from marl_mm.eval.studies.cells import kept_rows
from marl_mm.eval.studies.cost import GoalTimes, hours_table
from marl_mm.eval.studies.engines import EnginesOptions, cells_of
from marl_mm.progress import Bar
from marl_mm.sim.config import ENGINES


def plan_engines(options: EnginesOptions, bar: Bar) -> str:
    """How many policies are missing, and hours if all goals take all steps; Markdown.

    Args:
        options: Settings of the comparison.
        bar: Factory of progress bars.

    Raises:
        UsageError: If an option makes no sense, or an engine lacks a task.
    """
    options.check_settings()
    lines, goal_times = [], GoalTimes()
    advance = bar("measuring", len(options.tasks) * len(ENGINES))
    for task, engine in product(options.tasks, ENGINES):
        cells = [cell for cell in cells_of(task, options) if cell.engine == engine]
        kept = kept_rows(cells, options.cells_folder)
        left = [cell for cell in cells if cell not in kept]
        seconds = 0.0
        if left and not options.small:
            per_goal = goal_times(task, left[0].overrides)
            seconds = per_goal * sum(cell.goals for cell in left)
        lines.append(((task, engine), len(left), len(cells), seconds))
        advance(1, f"{task} {engine}")
    return hours_table(("task", "engine"), lines, options.workers, not options.small)
