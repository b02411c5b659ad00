"""Both engines beside each other: what policies and agents do on one and the other.

``engines`` runs many policies on the same goals of both engines. ``transfer`` trains
agents from datasets of each engine and evaluates them on both: a 2 x 2 table.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

from marl_mm.algorithms.checkpoint import FILE
from marl_mm.envs.registry import DEFAULT, fewest_steps, make_task
from marl_mm.eval.evaluate import check_task
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies.cells import (
    missing_groups,
    read_cells,
    run_cells,
    write_cells,
)
from marl_mm.eval.studies.engines_summary import agreement, paired
from marl_mm.eval.studies.offline import BLOCKS, LEARNERS
from marl_mm.eval.studies.options import PolicyOptions, StudyOptions
from marl_mm.eval.studies.policies import Contestant, PolicyCell, run_cell
from marl_mm.eval.studies.settings import Probe
from marl_mm.eval.studies.study import Study, cell_name
from marl_mm.progress import Bar
from marl_mm.runs.folder import read_config
from marl_mm.runs.sources import Source
from marl_mm.sim.config import ENGINES, Engine

ABOUT = "Policies on both engines, on the same goals, and how far the engines agree."
"""Title."""

TABLE, AGREEMENT = "engines.csv", "engines_agreement.csv"
"""Files of the tables: a row per task and policy, and a row per task and measure."""

FIGURE = "engines.png"
"""File of the figure: a point per task and policy."""

_NAMES: Mapping[Engine, str] = {"bullet": "PyBullet", "mujoco": "MuJoCo"}

TRANSFER = Study(
    "Table: agents from data of one engine on both.",
    tuple(
        product(
            (
                Source("pretrained", steps=10_000, name=f"good-10k-{e}", engine=e)
                for e in ENGINES
            ),
            LEARNERS,
        )
    ),
    tuple(
        Probe(f"on-{e}", f"on {_NAMES[e]}", overrides={"simulation": {"engine": e}})
        for e in ENGINES
    ),
)
"""Datasets of each engine, and evaluations on both."""


# --- Policies ----------------------------------------------------------------


def _steering(collector: str) -> list[Contestant]:
    """PD agents or scripts of several gains and alphas."""
    return [
        Contestant(
            f"{collector}-kp{kp:g}-alpha{alpha:g}",
            collector,
            (("alpha", alpha), ("kp", kp)),
        )
        for kp in (2.0, 5.0, 10.0)
        for alpha in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]


_REACHING = (
    *_steering("pd"),
    Contestant("pd-room", "pd", (("alpha_rule", "room"),)),
    *(
        Contestant(f"pretrained-noise{s:g}", "pretrained", noise=s)
        for s in (0.0, 0.25, 0.5, 1.0)
    ),
    *(Contestant(f"medium-{n}", "medium", (("random_steps", n),)) for n in (5, 10, 15)),
    Contestant("random", "random"),
)
"""Policies of the tasks that have the layout of the default one."""

_HANDLING = (
    *_steering("scripted"),
    *(
        Contestant(f"scripted-noise{s:g}", "scripted", noise=s)
        for s in (0.05, 0.1, 0.2, 0.5, 1.0)
    ),
    Contestant("random", "random"),
)
"""Policies of the other tasks."""


def contestants(task: str, options: StudyOptions) -> list[Contestant]:
    """Policies of a task, with the agents whose runs are in ``runs``.

    They are those of ``transfer``, or where a hand grasps those of ``blocks``, which
    are named with the engine of their data, too.
    """
    reaches = make_task(task).layout == make_task(DEFAULT).layout
    grasping = [c for c in product(BLOCKS, LEARNERS) if c[0].task == task]
    agents = []
    seed, *_ = options.seeds_of(TRANSFER)
    for cell in TRANSFER.cells if reaches else grasping:
        run = options.run_folder(cell, seed)
        if (run / FILE).exists():
            source, setting = cell_name(cell)
            if not reaches:
                source = f"scripted-20k-{read_config(run).engine}"
            about = (("agent", str(run)),)
            agents.append(Contestant(f"{setting}-{source}", "pretrained", about))
    return [*(_REACHING if reaches else _HANDLING), *agents]


# --- Cells -------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class EnginesOptions(PolicyOptions):
    """Settings of the comparison of the engines."""

    tasks: tuple[str, ...] = (
        "Reach-v0",
        "SmoothReach-v0",
        "PreciseReach-v0",
        "CarryReach-v0",
        "Grasp-v0",
        "GraspReach-v0",
    )
    """Registered names of the tasks."""

    @property
    def cells_folder(self) -> Path:
        """Folder of the policies' rows."""
        return self.runs_folder / "engines"


def make_engines(options: EnginesOptions, bar: Bar) -> list[Row]:
    """Run what is missing of the policies on both engines, and draw the tables.

    Returns:
        Rows of the table.

    Raises:
        UsageError: If an option makes no sense, or an engine lacks a task.
        KeyboardInterrupt: After Ctrl-C; finished policies are kept.
    """
    options.check_settings()
    missing = missing_groups(groups_of(options), options.overwrite)
    tasks = [task for task in options.tasks if rows_path(options, task) in missing]
    cells = [cell for task in tasks for cell in cells_of(task, options)]
    for task, engine in product(options.tasks, ENGINES):  # before any work is done
        check_task(make_task(task, {"simulation": {"engine": engine}}))
    pool = options.workers, (bar, "engines"), options.executor
    rows = run_cells(run_cell, cells, options.cells_folder, *pool)
    for task in tasks:
        of_task = {recorded(cell): rows[cell] for cell in cells if cell.task == task}
        write_cells(rows_path(options, task), [*of_task], of_task)
    return draw_engines(options.results, options.results)


def cells_of(task: str, options: EnginesOptions) -> list[PolicyCell]:
    """Cells of a task: every policy on every engine."""
    every = contestants(task, options)
    goals, max_steps = options.goals, None
    if options.small:
        goals, max_steps = 2, fewest_steps(task, 4)
    return [
        PolicyCell(task, engine, contestant, goals, max_steps, _weights(contestant))
        for contestant in (every[::8] if options.small else every)
        for engine in ENGINES
    ]


def rows_path(options: EnginesOptions, task: str) -> Path:
    """Path of a task's rows, see ``write_cells``."""
    return _rows_folder(options.results) / task


def groups_of(options: EnginesOptions) -> dict[Path, list[PolicyCell]]:
    """Cells by that path, as they are recorded."""
    return {
        rows_path(options, task): [*map(recorded, cells_of(task, options))]
        for task in options.tasks
    }


def recorded(cell: PolicyCell) -> PolicyCell:
    """A cell with its agent's run by source, setting and seed, wherever it lies."""
    settings = {
        name: "/".join(Path(value).parts[-3:]) if name == "agent" else value
        for name, value in cell.contestant.settings
    }
    contestant = replace(cell.contestant, settings=tuple(settings.items()))
    return replace(cell, contestant=contestant)


def _weights(contestant: Contestant) -> str:
    agent = dict(contestant.settings).get("agent")
    if agent is None:
        return ""
    policy = contestant.policy(DEFAULT, {})
    return str(policy.describe().get("weights", ""))


def _rows_folder(results: Path) -> Path:
    return results / "rows" / "engines"


def draw_engines(results: Path, folder: Path) -> list[Row]:
    """Write tables and figure into a folder, from rows in another.

    Returns:
        Rows of the table of policies.

    Raises:
        UsageError: If there are no rows.
    """
    from marl_mm.eval.studies.figures import engines_figure  # imports matplotlib

    tables = read_cells(_rows_folder(results))
    summary = [row for task, rows in tables.items() for row in paired(task, rows)]
    write_csv(folder / TABLE, summary)
    write_csv(folder / AGREEMENT, agreement(summary))
    engines_figure(summary, folder / FIGURE)
    return summary
