"""What several agents are good for: teams against joint actors under disturbances.

Every algorithm that has both forms, and is tuned in both, is trained in each from the
same data. Forms are compared goal by goal: by their success under a disturbance, or
beside an agent of another run, and by what they lose against the undisturbed run. A
form that reaches few goals can lose few.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.chosen import CHOSEN, UPDATES
from marl_mm.envs.registry import fewest_steps
from marl_mm.errors import UsageError
from marl_mm.eval.disturbances import Mixed
from marl_mm.eval.evaluate import Setup
from marl_mm.eval.metrics import EvaluationRow, Row
from marl_mm.eval.robustness import robustness
from marl_mm.eval.studies.cells import missing_groups, recorded_cells, run_cells
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.robustness_summary import (
    CLEAN,
    FORMS,
    OTHER_ALGORITHM,
    OTHER_SEED,
    PREFIX,
    SETTINGS,
    SOURCES,
    draw_robustness,
    rows_folder,
)
from marl_mm.eval.studies.settings import setting_of
from marl_mm.eval.studies.study import Study, cell_name
from marl_mm.eval.suite import ROBUSTNESS, conditions
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.evaluate import task_overrides
from marl_mm.runs.recipes import RECIPES
from marl_mm.runs.run import Run
from marl_mm.runs.settings import check_positive
from marl_mm.runs.train import dataset_of

ABOUT = "Teams against joint actors under disturbances."
"""Title."""

STUDY = Study(
    "Table: teams and joint actors before they are disturbed.",
    tuple(
        (
            RECIPES.get(recipe).source,
            setting_of(f"{PREFIX}{name}", name, UPDATES, CHOSEN[name], curve_goals=2),
        )
        for recipe, form in product(SOURCES.values(), FORMS)
        for name in form
        if CHOSEN.keys() >= {*form}
    ),
)
"""Study whose runs are disturbed."""

_GOALS_DIVISOR = {"Bar-v0": 4}
"""What the number of a task's goals is divided by."""


@dataclass(frozen=True, kw_only=True)
class RobustnessOptions(StudyOptions):
    """Settings of the comparison under disturbances."""

    datasets: tuple[str, ...] | None = None
    """Names of the datasets whose runs are disturbed; default both."""

    goals: int = 50
    """Number of goals of each run and condition, the same for all; of Bar, whose
    episodes take six times as long, a quarter."""

    def check_settings(self) -> None:
        """Raise for options that make no sense.

        Raises:
            UsageError: Naming the option.
        """
        super().check_settings()
        check_positive(goals=self.goals)

    @property
    def study(self) -> Study:
        """Runs that are disturbed."""
        return STUDY.part(self.datasets, None)


@dataclass(frozen=True)
class TrainedRun:
    """A trained run: its setting, seed and weights."""

    setting: str
    """Name of the setting."""

    seed: int
    """Seed of the run."""

    weights: str = ""
    """Fingerprint of the run's weights; empty while it is left open."""


@dataclass(frozen=True)
class RobustCell:
    """A run under the suite: everything that its rows depend on."""

    dataset: str
    """Name of the dataset."""

    run: TrainedRun
    """The run."""

    partners: tuple[TrainedRun, ...]
    """Runs whose agents replace the run's, one agent at a time."""

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
        engine = RECIPES.get(SOURCES[self.dataset]).source.engine
        return task_overrides(self.max_steps, engine)

    @property
    def setup(self) -> Setup:
        """Task and goals of the evaluations."""
        return Setup(self.task, self.overrides, self.goals, seed=0)

    @property
    def episodes(self) -> int:
        """Number of episodes of all its evaluations."""
        agents = len(self.setup.made.layout.team)
        ways = 1 + len(self.conditions) + agents * len(self.partners)
        return self.goals * ways

    @property
    def label(self) -> str:
        """Label in the progress bar."""
        return f"{self.run.setting} {self.run.seed} {self.task}"


def _names(options: StudyOptions) -> Sequence[str]:
    """Names of the disturbances; with the smoke budget two of them."""
    return ("noisy", "wheel friction") if options.small else [*ROBUSTNESS]


def cells_of(
    options: RobustnessOptions, dataset: str, setting: str
) -> list[RobustCell]:
    """Runs of a setting under the suite, a seed each, weights left open.

    Partners are the setting's other seeds, and the same seed of the other algorithms
    whose actors are joint, or teams, as its own.
    """
    source = RECIPES.get(SOURCES[dataset]).source
    max_steps = fewest_steps(source.task, 4) if options.small else None
    goals = math.ceil(options.goals / _GOALS_DIVISOR.get(source.task, 1))
    goals = 2 if options.small else goals
    overrides = task_overrides(max_steps, source.engine)
    listed, _ = conditions(source.task, overrides, _names(options))
    words, seeds = tuple(map(str, listed)), options.seeds_of(STUDY)
    runs = [TrainedRun(setting, seed) for seed in seeds]
    of_data = [s for name, s in map(cell_name, STUDY.cells) if name == dataset]
    (form,) = (names for names in SETTINGS if setting in names)
    alike = [name for name in of_data if name in form and name != setting]
    return [
        RobustCell(
            dataset,
            run,
            (
                *(*runs[number + 1 :], *runs[:number]),
                *(TrainedRun(name, run.seed) for name in alike),
            ),
            goals,
            words,
            max_steps,
        )
        for number, run in enumerate(runs)
    ]


def _with_weights(
    options: StudyOptions, path: Path, cells: Sequence[RobustCell]
) -> list[RobustCell]:
    """Cells with the fingerprints of their runs' weights.

    Where a run is gone, they are those recorded with its rows.

    Raises:
        UsageError: If there is neither run nor row.
    """
    # Older ones lack partners.
    made = [cell for cell in recorded_cells(path) if "partners" in cell]
    records = [record for cell in made for record in (cell["run"], *cell["partners"])]
    kept = {(each["setting"], each["seed"]): TrainedRun(**each) for each in records}

    def with_fingerprint(dataset: str, run: TrainedRun) -> TrainedRun:
        recorded = kept.get((run.setting, run.seed))
        if recorded and not (_folder(options, dataset, run) / FILE).exists():
            return recorded
        return replace(run, weights=_run(options, dataset, run).policy.fingerprint)

    return [
        replace(
            cell,
            run=with_fingerprint(cell.dataset, cell.run),
            partners=tuple(
                with_fingerprint(cell.dataset, partner) for partner in cell.partners
            ),
        )
        for cell in cells
    ]


def _folder(options: StudyOptions, dataset: str, trained: TrainedRun) -> Path:
    names = dataset, trained.setting
    (cell,) = (cell for cell in STUDY.cells if cell_name(cell) == names)
    return options.run_folder(cell, trained.seed)


def _run(options: StudyOptions, dataset: str, trained: TrainedRun) -> Run:
    run = Run(_folder(options, dataset, trained))
    if not (run.folder / FILE).exists():
        raise UsageError(
            f"{run.folder} is gone, and {options.store.folder} has its evaluations: "
            f"delete those of {trained.setting}, or bring the run back"
        )
    return run


def run_cell(options: RobustnessOptions, cell: RobustCell) -> list[Row]:
    """A row per condition and goal. Noise is in units of the dataset's spread."""
    run = _run(options, cell.dataset, cell.run)
    data = dataset_of(run.config)
    assert data is not None
    *_, result = robustness(
        cell.setup,
        run.policy,
        cell.label,
        silent_bar,
        names=_names(options),
        spread=data.arrays.states.std(axis=0),
    )
    head = {
        "dataset": cell.dataset,
        "setting": cell.run.setting,
        "engine": result.clean.engine,
        "seed": cell.run.seed,
    }
    rows = [head | _goal_row(CLEAN, "", 0, row) for row in result.clean.rows]
    for condition, evaluation in result.disturbed.items():
        name, agent = condition.disturbance, condition.agent
        strength = condition.strength
        rows += [
            head | _goal_row(name, agent, strength, row) for row in evaluation.rows
        ]
    agents = [agent.name for agent in cell.setup.made.layout.team]
    with cell.setup.rollouts() as rollouts:
        for (number, other), agent in product(enumerate(cell.partners, 1), agents):
            partner = _run(options, cell.dataset, other)
            mixed = Mixed(run.policy, {agent: partner.policy})
            algorithm = partner.config.algorithm
            same = algorithm == run.config.algorithm  # another seed, by its number
            kind = OTHER_SEED if same else OTHER_ALGORITHM
            amount = number if same else algorithm
            evaluation = cell.setup.run(rollouts, mixed)
            rows += [
                head | _goal_row(kind, agent, amount, row) for row in evaluation.rows
            ]
    return rows


def _goal_row(
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
    """Disturb the runs of ``STUDY`` where that is missing, and draw the table.

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
    for dataset, setting in map(cell_name, options.study.cells):
        path = rows_path(options, dataset, setting)
        cells = cells_of(options, dataset, setting)
        groups[path] = _with_weights(options, path, cells)
    missing = missing_groups(groups, options.overwrite)
    run_cells(
        partial(run_cell, options),
        [cell for cells in missing.values() for cell in cells],
        options.runs_folder / "robustness",
        options.workers,
        (bar, "robustness"),
        options.executor,
        missing,
    )
    return draw_robustness(options.results, options.results)


def rows_path(options: StudyOptions, dataset: str, setting: str) -> Path:
    """Path of a setting's rows, see ``write_cells``."""
    return rows_folder(options.results) / f"{dataset}-{setting}".replace("/", "-")
