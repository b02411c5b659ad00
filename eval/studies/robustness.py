"""What several agents are good for: teams against joint actors under disturbances.

Every algorithm that has both forms, and is tuned in both, is trained in each from the
same data. Goal by goal it is compared what a form reaches under a disturbance, and what
that is less than without: a form that reaches few goals has few to lose.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from marl_mm.algorithms.checkpoint import FILE
from marl_mm.envs.registry import fewest_steps
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.evaluate import Setup
from marl_mm.eval.metrics import EvaluationRow, Row
from marl_mm.eval.robustness import robustness
from marl_mm.eval.studies.cells import missing_groups, run_cells
from marl_mm.eval.studies.cost import GoalTimes, hours_table
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.robustness_summary import (
    CLEAN,
    FORMS,
    SOURCES,
    draw_robustness,
    rows_folder,
)
from marl_mm.eval.studies.study import Study, cell_name, setting_of
from marl_mm.eval.studies.tuned import CHOSEN
from marl_mm.eval.suite import ROBUSTNESS, conditions
from marl_mm.progress import Bar, silent_bar
from marl_mm.received import read_json
from marl_mm.runs.recipes import RECIPES
from marl_mm.runs.run import Run
from marl_mm.runs.settings import check_positive
from marl_mm.runs.sources import Source
from marl_mm.runs.train import dataset_of
from marl_mm.sim.config import engine_overrides

ABOUT = "Teams against joint actors under disturbances."
"""Title."""

UPDATES = 5_000
"""Updates of all algorithms."""


AGENTS = Study(
    "Table: teams and joint actors before they are disturbed.",
    tuple(
        (
            RECIPES.get(recipe).source,
            setting_of(f"robust-{name}", name, UPDATES, CHOSEN[name]),
        )
        for recipe, form in product(SOURCES.values(), FORMS)
        for name in form
        if CHOSEN.keys() >= {*form}
    ),
)
"""Study whose runs are disturbed."""


@dataclass(frozen=True, kw_only=True)
class RobustnessOptions(StudyOptions):
    """Settings of the comparison under disturbances."""

    goals: int = 100
    """Number of goals of each run and condition, the same for all."""

    def check_settings(self) -> None:
        """Raise for options that make no sense.

        Raises:
            UsageError: Naming the option.
        """
        super().check_settings()
        check_positive(goals=self.goals)


@dataclass(frozen=True)
class RobustCell:
    """A run under the suite: everything that its rows depend on."""

    dataset: str
    """Name of the dataset."""

    setting: str
    """Name of the setting."""

    seed: int
    """Seed of the run."""

    weights: str
    """Fingerprint of the run's weights."""

    goals: int
    """Number of goals of each condition."""

    conditions: tuple[str, ...]
    """Conditions in words."""

    max_steps: int | None
    """Steps of an episode; None: the task's."""

    @property
    def task(self) -> str:
        """Registered name of the task."""
        return RECIPES.get(SOURCES[self.dataset]).source.task

    @property
    def overrides(self) -> dict[str, Any]:
        """Settings of the task that are replaced."""
        return _overrides(RECIPES.get(SOURCES[self.dataset]).source, self.max_steps)

    @property
    def label(self) -> str:
        """Label in the progress bar."""
        return f"{self.setting} {self.seed} {self.task}"


def _overrides(source: Source, max_steps: int | None) -> dict[str, Any]:
    steps = {} if max_steps is None else {"max_steps": max_steps}
    return {**steps, **engine_overrides(source.engine)}


def _names(options: StudyOptions) -> Sequence[str]:
    """Names of the disturbances; with the smoke budget two of them."""
    return ("noisy", "wheel friction") if options.small else [*ROBUSTNESS]


def cells_of(
    options: RobustnessOptions, dataset: str, setting: str
) -> list[RobustCell]:
    """Runs of a setting under the suite, a seed each, their weights left open."""
    source = RECIPES.get(SOURCES[dataset]).source
    max_steps = fewest_steps(source.task, 4) if options.small else None
    goals = 2 if options.small else options.goals
    overrides = _overrides(source, max_steps)
    listed, _ = conditions(source.task, overrides, _names(options))
    words = tuple(map(str, listed))
    return [
        RobustCell(dataset, setting, seed, "", goals, words, max_steps)
        for seed in options.seeds_of(AGENTS)
    ]


def _with_weights(
    options: StudyOptions, path: Path, cells: Sequence[RobustCell]
) -> list[RobustCell]:
    """Cells with the fingerprints of their runs; of those that are gone, of the rows.

    Raises:
        UsageError: If there is neither run nor row.
    """
    record = path.with_suffix(".json")
    made = read_json(record, MarlMmError).get("cells", []) if record.exists() else []
    kept = {cell["seed"]: cell["weights"] for cell in made}
    return [
        replace(
            cell,
            weights=kept[cell.seed]
            if cell.seed in kept and not (_folder(options, cell) / FILE).exists()
            else _run(options, cell).policy.fingerprint,
        )
        for cell in cells
    ]


def _folder(options: StudyOptions, of: RobustCell) -> Path:
    names = of.dataset, of.setting
    (cell,) = (cell for cell in AGENTS.cells if cell_name(cell) == names)
    return options.run_folder(cell, of.seed)


def _run(options: StudyOptions, of: RobustCell) -> Run:
    run = Run(_folder(options, of))
    if not (run.folder / FILE).exists():
        raise UsageError(
            f"{run.folder} is gone, and {options.store.folder} has its evaluations: "
            f"delete those of {of.setting}, or bring the run back"
        )
    return run


def run_cell(options: RobustnessOptions, cell: RobustCell) -> list[Row]:
    """A row per condition and goal. Noise is in units of the dataset's spread."""
    run = _run(options, cell)
    data = dataset_of(run.config)
    assert data is not None
    setup = Setup(cell.task, cell.overrides, cell.goals, seed=0)
    about = cell.label, silent_bar, _names(options), data.arrays.states.std(axis=0)
    *_, result = robustness(setup, run.policy, *about)
    head = {
        "dataset": cell.dataset,
        "setting": cell.setting,
        "engine": result.clean.engine,
        "seed": cell.seed,
    }
    rows = [head | _goal(CLEAN, "", 0, row) for row in result.clean.rows]
    for condition, evaluation in result.disturbed.items():
        of = condition.disturbance, condition.agent, condition.strength
        rows += [head | _goal(*of, row) for row in evaluation.rows]
    return rows


def _goal(
    disturbance: str, agent: str, strength: float | str, row: EvaluationRow
) -> Row:
    return {
        "disturbance": disturbance,
        "agent": agent,
        "strength": strength,
        "goal": row["index"],
        "success": int(row["success"]),
        "steps": row["steps"],
        "return": row["return"],
        "reason": row.get("reason", ""),
    }


def make_robustness(options: RobustnessOptions, bar: Bar) -> list[Row]:
    """Disturb the runs of ``AGENTS`` where that is missing, and draw the table.

    Returns:
        Rows of the table.

    Raises:
        UsageError: If an option makes no sense, or a run is gone.
        KeyboardInterrupt: After Ctrl-C; finished runs are kept.
    """
    options.check_settings()
    # Processes of a cluster start in other folders.
    options = replace(options, runs=options.runs_folder.absolute(), out=options.results)
    groups = {}
    for dataset, setting in map(cell_name, AGENTS.cells):
        path = _path(options, dataset, setting)
        cells = cells_of(options, dataset, setting)
        groups[path] = _with_weights(options, path, cells)
    missing = missing_groups(groups)
    every = [cell for cells in missing.values() for cell in cells]
    folder, run = options.runs_folder / "robustness", partial(run_cell, options)
    pool = options.workers, (bar, "robustness"), options.executor
    run_cells(run, every, folder, *pool, missing)
    return draw_robustness(options.results, options.results)


def _path(options: StudyOptions, dataset: str, setting: str) -> Path:
    """Path of a setting's rows, see ``write_cells``."""
    return rows_folder(options.results) / f"{dataset}-{setting}".replace("/", "-")


def plan_robustness(options: RobustnessOptions, bar: Bar) -> str:
    """How many runs are to be disturbed, and hours at most, as Markdown.

    Raises:
        UsageError: If an option makes no sense.
    """
    options.check_settings()
    lines, goal_times = [], GoalTimes()
    advance = bar("measuring", len(AGENTS.cells))
    for dataset, setting in map(cell_name, AGENTS.cells):
        cells = cells_of(options, dataset, setting)
        path = _path(options, dataset, setting).with_suffix(".json")
        left = [] if path.exists() else cells
        seconds = 0.0
        if left and not options.small:
            per_goal = goal_times(left[0].task, left[0].overrides)
            seconds = per_goal * sum(c.goals * (1 + len(c.conditions)) for c in left)
        lines.append(((dataset, setting), len(left), len(cells), seconds))
        advance(1, setting)
    heads = "dataset", "setting, disturbed"
    return hours_table(heads, lines, options.workers, not options.small)
