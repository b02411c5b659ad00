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

import numpy as np

from marl_mm.algorithms.checkpoint import FILE
from marl_mm.envs.registry import fewest_steps
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.evaluate import Setup
from marl_mm.eval.grouping import by_goal, grouped
from marl_mm.eval.intervals import interval_of_mean
from marl_mm.eval.metrics import EvaluationRow, Row
from marl_mm.eval.robustness import robustness
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies.cells import missing_groups, read_cells, run_cells
from marl_mm.eval.studies.cost import GoalTimes, hours_table
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.study import Study, cell_name, setting_of
from marl_mm.eval.studies.tuned import CHOSEN
from marl_mm.eval.suite import ROBUSTNESS, conditions
from marl_mm.eval.tables import markdown_table
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

TABLE = "robustness.csv"
"""File of the table, a row per dataset, algorithm and disturbance."""

FORMS = (
    *(("bc", "mabc"), ("flow-bc", "ma-flow-bc"), ("iql", "ma-iql")),
    *(("rebrac", "ma-rebrac"), ("td3-bc", "matd3-bc"), ("cql", "cfcql")),
    *(("fql", "mac-flow"), ("best-of-n-joint", "best-of-n")),
)
"""Algorithms: the form with a joint actor, and the team's."""

SOURCES = {
    RECIPES.get(name).source.name: name for name in ("quiet-zone-expert", "gate-expert")
}
"""Recipes of the datasets that are learnt from, by the datasets' names."""

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

FEW = 0.3
"""Success rate below which a form has few goals to lose."""

CLEAN, ALL = "clean", "all"
"""Names of the run without a disturbance, and of the mean over disturbances."""


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
        file = f"{dataset}-{setting}".replace("/", "-")
        path = _rows_folder(options.results) / file
        cells = cells_of(options, dataset, setting)
        groups[path] = _with_weights(options, path, cells)
    missing = missing_groups(groups)
    every = [cell for cells in missing.values() for cell in cells]
    folder, pool = options.runs_folder / "robustness", (options.workers,)
    shown = bar, "robustness"
    run = partial(run_cell, options)
    run_cells(run, every, folder, *pool, shown, options.executor, missing)
    return draw_robustness(options.results, options.results)


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
        file = f"{dataset}-{setting}.json".replace("/", "-")
        left = [] if (_rows_folder(options.results) / file).exists() else cells
        seconds = 0.0
        if left and not options.small:
            per_goal = goal_times(left[0].task, left[0].overrides)
            seconds = per_goal * sum(c.goals * (1 + len(c.conditions)) for c in left)
        lines.append(((dataset, setting), len(left), len(cells), seconds))
        advance(1, setting)
    heads = "dataset", "setting, disturbed"
    return hours_table(heads, lines, options.workers, not options.small)


def _rows_folder(results: Path) -> Path:
    return results / "rows" / "robustness"


# --- Tables ------------------------------------------------------------------


def draw_robustness(results: Path, folder: Path) -> list[Row]:
    """Write the table into a folder, from rows in another.

    Returns:
        Rows of the table.

    Raises:
        UsageError: If there are no rows.
    """
    read = read_cells(_rows_folder(results)).values()
    cells = grouped([row for rows in read for row in rows], "dataset", "setting")
    summary: list[Row] = []
    for dataset, form in product(SOURCES, FORMS):
        pair = [cells.get((dataset, f"robust-{name}"), []) for name in form]
        if all(pair):
            summary += _compared({"dataset": dataset, "joint": form[0]}, *pair)
    write_csv(folder / TABLE, summary)
    return summary


def _compared(head: Row, joint: Sequence[Row], team: Sequence[Row]) -> list[Row]:
    """A row per disturbance, and one of their mean."""
    of_joint, of_team = _changes(joint), _changes(team)
    clean = _successes(team) - _successes(joint)
    rows = []
    for name in of_joint:
        more = of_team[name] - of_joint[name]
        ahead = more + clean
        rows.append(
            {
                **head,
                "engine": joint[0]["engine"],
                "disturbance": name,
                "seeds": len(more),
                "goals": more.shape[1],
                "joint_clean": float(_successes(joint).mean()),
                "joint_change": float(of_joint[name].mean()),
                "team_clean": float(_successes(team).mean()),
                "team_change": float(of_team[name].mean()),
                "keeps_more": float(more.mean()),
                "keeps_more_interval": interval_of_mean(more),
                "ahead": float(ahead.mean()),
                "ahead_interval": interval_of_mean(ahead),
            }
        )
    return rows


def _successes(rows: Sequence[Row]) -> np.ndarray:
    """Success without a disturbance, shape (seeds, goals)."""
    seeds = len(grouped(rows, "seed"))
    clean = by_goal(grouped(rows, "disturbance")[CLEAN], "success")
    return clean.reshape(seeds, -1)


def _changes(rows: Sequence[Row]) -> dict[str, np.ndarray]:
    """Success less that of the clean run, by disturbance, shapes (seeds, goals).

    It is the mean over agents and strengths; ``ALL`` is the mean over disturbances.
    """
    clean, changes = _successes(rows), {}
    for name, some in grouped(rows, "disturbance").items():
        if name != CLEAN:
            every = grouped(some, "agent", "strength").values()
            mean = np.mean([by_goal(rows, "success") for rows in every], axis=0)
            changes[name] = mean.reshape(clean.shape) - clean
    return {**changes, ALL: np.mean([*changes.values()], axis=0)}


def robustness_table(summary: Sequence[Row]) -> str:
    """What teams keep more than joint actors, a line per algorithm, as Markdown."""
    names = list(dict.fromkeys(row["disturbance"] for row in summary))
    lines = []
    for (dataset, joint), rows in grouped(summary, "dataset", "joint").items():
        by_name = {row["disturbance"]: row for row in rows}
        reached = [
            f"{100 * by_name[ALL][f'{form}_clean']:.1f}, "
            f"{100 * by_name[ALL][f'{form}_change']:+.1f}"
            for form in ("joint", "team")
        ]
        about = f"`{SOURCES[dataset]}`", f"`{joint}`, `{dict(FORMS)[joint]}`"
        ahead = _points(by_name[ALL], "ahead")
        more = (_points(by_name.get(name), "keeps_more") for name in names)
        lines.append([*about, *reached, ahead, *more])
    heads = ["dataset", "joint actor, team", "joint actor [%]", "team [%]"]
    heads += ["team ahead, disturbed"]
    table = markdown_table([*heads, *names], lines)
    engines = ", ".join(sorted({row["engine"] for row in summary}))
    return f"Engine {engines}.\n\n{table}"


def _points(row: Row | None, name: str) -> str:
    """A difference in points, in brackets where a form has few goals to lose."""
    if row is None:
        return ""
    values = (row[name], *row[f"{name}_interval"])
    mean, low, high = (f"{100 * value:+.1f}" for value in values)
    few = min(row["joint_clean"], row["team_clean"]) < FEW
    return f"({mean} [{low}, {high}])" if few else f"{mean} [{low}, {high}]"
