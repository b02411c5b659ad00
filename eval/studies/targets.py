"""Targets of ``marl-mm ablate``: our studies by name, and studies of user files."""

import runpy
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies import (
    alpha,
    baselines,
    benchmark,
    coordination,
    early,
    engines,
    fine_tuning,
    offline,
    online,
    paper,
    robustness,
    robustness_summary,
    separation,
    tuning,
)
from marl_mm.eval.studies.benchmark_tables import benchmark_table
from marl_mm.eval.studies.engines_summary import engines_table
from marl_mm.eval.studies.policies_plan import plan_coordination, plan_engines
from marl_mm.eval.studies.robustness_plan import plan_robustness
from marl_mm.eval.studies.study import Study
from marl_mm.progress import Bar

_OF_THE_PAPERS_TASKS = paper.STUDIES | offline.STUDIES | online.STUDIES

STUDIES = {
    **_OF_THE_PAPERS_TASKS,
    "transfer": engines.TRANSFER,
    "baselines": baselines.BASELINES,
    "separation": separation.SEPARATION,
    "fine-tuning": fine_tuning.FINE_TUNING,
    "grasp": online.GRASP,
}
"""Studies by name."""


@dataclass(frozen=True)
class Comparison:
    """A table that is made by running policies, beside those of studies."""

    about: str
    """Title."""

    file: str
    """File of the table."""

    make: Callable[[Any, Bar], list[Row]]
    """Function of options and a factory of progress bars that runs what is missing,
    draws, and returns the rows of the table."""

    draw: Callable[[Path, Path], object]
    """Function that draws from the rows in one folder into another."""

    markdown: Callable[[list[Row]], str]
    """Function of the rows that returns the table as Markdown."""

    study: Study | None = None
    """Study whose runs are compared, and are trained first."""

    in_parts: tuple[str, ...] = ()
    """Options that choose some of those runs; the table is of all that have rows."""

    plan: Callable[[Any, Bar], str] | None = None
    """Function of options and a factory of progress bars that says what is missing."""


Comparisons = dict[str, Comparison]

COMPARISONS: Comparisons = {
    "alpha": Comparison(
        alpha.ABOUT,
        alpha.WORTH,
        alpha.make_worth,
        alpha.draw_worth,
        alpha.worth_table,
        alpha.CHOOSING,
    ),
    "engines": Comparison(
        engines.ABOUT,
        engines.TABLE,
        engines.make_engines,
        engines.draw_engines,
        engines_table,
        plan=plan_engines,
    ),
    "coordination": Comparison(
        coordination.ABOUT,
        coordination.TABLE,
        coordination.make_coordination,
        coordination.draw_coordination,
        coordination.coordination_table,
        plan=plan_coordination,
    ),
    "robustness": Comparison(
        robustness.ABOUT,
        robustness_summary.TABLE,
        robustness.make_robustness,
        robustness_summary.draw_robustness,
        robustness_summary.robustness_table,
        robustness.STUDY,
        in_parts=("datasets",),
        plan=plan_robustness,
    ),
    "benchmark": Comparison(
        benchmark.ABOUT,
        benchmark.TABLE,
        benchmark.make_benchmark,
        benchmark.draw_benchmark,
        benchmark_table,
        benchmark.STUDY,
        in_parts=("datasets", "settings"),
    ),
    "early": Comparison(
        early.ABOUT,
        early.TABLE,
        early.make_early,
        early.draw_early,
        early.early_table,
        early.STUDY,
        in_parts=("datasets", "settings"),
    ),
    "tuning": Comparison(
        tuning.ABOUT,
        tuning.TABLE,
        tuning.make_tuning,
        tuning.draw_tuning,
        tuning.tuning_table,
        plan=tuning.plan_tuning,
    ),
}
"""Comparisons by name."""

GROUPS = {
    "paper": ("table4", "table5", "fig4", "fig5", "fig7", "fig8", "fig9", "fig10"),
    "all": (*_OF_THE_PAPERS_TASKS, "alpha"),
}
"""Targets by the name of their group: those of the paper's tasks on one engine."""


def part_of(
    target: str,
    studies: dict[str, Study],
    comparisons: Comparisons,
    part: Mapping[str, Sequence[str]],
) -> tuple[dict[str, Study], Comparisons]:
    """The part of a target's study, or of the runs that its comparison goes on with.

    Args:
        target: Name of the target.
        studies: Studies of the target, by name.
        comparisons: Comparisons of the target.
        part: Names of datasets, of settings or of both.

    Raises:
        UsageError: If the target has no such parts, or a name is unknown.
    """
    for name, comparison in comparisons.items():
        if not studies and comparison.study and {*part} <= {*comparison.in_parts}:
            cut = comparison.study.part(**part)
            return studies, {name: replace(comparison, study=cut)}
    if len(studies) != 1:
        asked = " and ".join(f"`{word}`" for word in part)
        raise UsageError(f"{asked} are for a study, not {target}")
    ((name, study),) = studies.items()
    cut = study.part(**part)
    whole = len(cut.cells) == len(study.cells)
    return {name if whole else f"{name}-part": cut}, comparisons


def study_of(path: Path, name: str) -> Study:
    """A study of a user's Python file.

    Raises:
        UsageError: If the file has no study of that name.
    """
    if not path.is_file():
        raise UsageError(f"there is no file {path}, expected FILE.py:NAME")
    sys.path.insert(0, str(path.parent))  # of what it imports itself
    try:
        variables = runpy.run_path(str(path))
    except MarlMmError as error:
        raise UsageError(f"{path}: {error}") from error
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise UsageError(f"{path} cannot be run: {reason:.300}") from error
    finally:
        sys.path.remove(str(path.parent))
    study = variables.get(name)
    if isinstance(study, Study):
        return study
    names = [key for key, value in variables.items() if isinstance(value, Study)]
    raise UsageError(
        f"{path} has no Study called {name!r}, expected one of "
        f"{', '.join(names) or 'its names: it has none'}"
    )
