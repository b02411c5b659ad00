"""Runs that are still to be disturbed, and the time that they will take."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from marl_mm.config_diff import as_json
from marl_mm.eval.studies.cells import recorded_cells
from marl_mm.eval.studies.cost import GoalTimes, hours_table
from marl_mm.eval.studies.robustness import RobustnessOptions, cells_of, rows_path
from marl_mm.eval.studies.study import cell_name
from marl_mm.progress import Bar


def plan_robustness(options: RobustnessOptions, bar: Bar) -> str:
    """How many runs are to be disturbed, and hours at most, as Markdown.

    Args:
        options: Settings of the comparison.
        bar: Factory of progress bars.

    Raises:
        UsageError: If an option makes no sense.
    """
    options.check_settings()
    lines, goal_times = [], GoalTimes()
    names = [cell_name(cell) for cell in options.study.cells]
    advance = bar("measuring", len(names))
    for dataset, setting in names:
        cells = cells_of(options, dataset, setting)
        made = recorded_cells(rows_path(options, dataset, setting))
        asked = as_json({"cells": list(map(asdict, cells))})["cells"]
        left = [] if list(map(_unweighed, made)) == asked else cells
        seconds = 0.0
        if left and not options.small:
            per_goal = goal_times(left[0].task, left[0].overrides)
            seconds = per_goal * sum(cell.episodes for cell in left)
        lines.append(((dataset, setting), len(left), len(cells), seconds))
        advance(1, setting)
    heads = "dataset", "setting, disturbed"
    return hours_table(heads, lines, options.workers, not options.small)


def _unweighed(cell: Mapping[str, Any]) -> dict[str, Any]:
    """A recorded cell with the weights of its runs left open."""
    others = [{**actor, "weights": ""} for actor in cell.get("partners", ())]
    return {**cell, "run": {**cell["run"], "weights": ""}, "partners": others}
