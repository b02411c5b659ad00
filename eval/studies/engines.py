"""Both engines beside each other: what policies and agents do on one and the other.

``engines`` runs many policies on the same goals of both engines. ``transfer`` trains
agents from datasets of each engine and evaluates them on both: a 2 x 2 table.
"""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.algorithms.checkpoint import FILE
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import evaluate
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import read_rows, write_csv
from marl_mm.eval.studies.cells import run_cells, write_cells
from marl_mm.eval.studies.engines_summary import agreement, paired
from marl_mm.eval.studies.offline import LEARNERS
from marl_mm.eval.studies.options import PolicyOptions, StudyOptions
from marl_mm.eval.studies.study import Probe, Study
from marl_mm.layout import Layout
from marl_mm.policy import Policy
from marl_mm.progress import Bar
from marl_mm.runs.settings import with_settings
from marl_mm.runs.sources import Source
from marl_mm.sim.config import ENGINES, Engine
from marl_mm.versions import engine_text

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


@dataclass(frozen=True)
class Contestant:
    """A policy of a collector, with noise on its actions."""

    name: str
    """Name in rows and tables."""

    collector: str
    """Registered name of the collector."""

    settings: tuple[tuple[str, Any], ...] = ()
    """Names and values of the collector's settings that are not its defaults."""

    noise: float = 0.0
    """Standard deviation of Gaussian noise on the actions, in their units."""

    def policy(self, task: str, overrides: Mapping[str, Any]) -> Policy:
        """The policy in a task."""
        collector = COLLECTORS.get(self.collector)
        what = f"collector {self.collector}"
        config = with_settings(what, collector.config(), dict(self.settings))
        policy = collector.policy(config, make_task(task, overrides))
        return Noisy(policy, self.noise) if self.noise else policy


class Noisy:
    """A policy with Gaussian noise on its actions, clipped to their ranges.

    Args:
        policy: Policy that acts.
        noise: Standard deviation of the noise, in the actions' units.
    """

    def __init__(self, policy: Policy, noise: float) -> None:
        self._policy, self._noise = policy, noise
        self.name = f"{policy.name}, noise {noise:g}"

    def describe(self) -> dict[str, Any]:
        """The noise, and the policy's own settings."""
        return {"noise": self._noise, **self._policy.describe()}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Take the episode's stream of random numbers."""
        self._rng, self._low, self._high = rng, layout.low, layout.high
        self._policy.begin(rng, layout)

    def act(self, state: np.ndarray) -> np.ndarray:
        """The policy's action plus noise."""
        action = self._policy.act(state)
        noisy = action + self._rng.normal(0.0, self._noise, len(action))
        return np.clip(noisy, self._low, self._high).astype(np.float32)


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
    """Policies of a task; those of ``transfer`` too, where its runs are in ``runs``."""
    if make_task(task).layout != make_task(DEFAULT).layout:
        return [*_HANDLING]
    agents = []
    seed, *_ = options.seeds_of(TRANSFER)
    for cell in TRANSFER.cells:
        run = options.run_folder(cell, seed)
        if (run / FILE).exists():
            name = "-".join((run.parent.name, *run.parts[-3:-2]))
            agents.append(Contestant(name, "pretrained", (("agent", str(run)),)))
    return [*_REACHING, *agents]


# --- Cells -------------------------------------------------------------------


@dataclass(frozen=True)
class EngineCell:
    """A policy in a task on an engine: everything its rows depend on."""

    task: str
    """Registered name of the task."""

    engine: Engine
    """Engine of the simulation."""

    contestant: Contestant
    """Policy."""

    goals: int
    """Number of goals, half ahead and half behind where the task draws none."""

    max_steps: int | None = None
    """Steps of an episode; default the task's."""

    weights: str = ""
    """Fingerprint of the weights of a learnt agent."""

    @property
    def overrides(self) -> dict[str, Any]:
        """Settings of the task that are replaced."""
        steps = {} if self.max_steps is None else {"max_steps": self.max_steps}
        return {**steps, "simulation": {"engine": self.engine}}

    @property
    def label(self) -> str:
        """Label in the progress bar."""
        return f"{self.task} {self.engine} {self.contestant.name}"


_MEASURED = ("steps", "return", "d_mm", "d_mp", "base_jerk_rms")


def run_cell(cell: EngineCell) -> list[Row]:
    """A row per goal."""
    policy = cell.contestant.policy(cell.task, cell.overrides)
    evaluation = evaluate(policy, cell.goals, 0, cell.task, cell.overrides)
    return [
        {
            "policy": cell.contestant.name,
            "engine": engine_text(cell.engine),
            "seed": 0,
            "goal": row["index"],
            "success": int(row["success"]),
            **{key: row.get(key, np.nan) for key in _MEASURED},
        }
        for row in evaluation.rows
    ]


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
    cells = [cell for task in options.tasks for cell in cells_of(task, options)]
    for task, engine in product(options.tasks, ENGINES):  # before any work is done
        check_task(task, engine)
    folder, pool = options.cells_folder, options.workers
    rows = run_cells(run_cell, cells, folder, pool, (bar, "engines"))
    for task in options.tasks:
        of_task = [cell for cell in cells if cell.task == task]
        write_cells(_rows_folder(options.results) / task, of_task, rows)
    return draw_engines(options.results, options.results)


def cells_of(task: str, options: EnginesOptions) -> list[EngineCell]:
    """Cells of a task: every policy on every engine."""
    every = contestants(task, options)
    goals, max_steps = (2, 4) if options.small else (options.goals, None)
    return [
        EngineCell(task, engine, contestant, goals, max_steps, _weights(contestant))
        for contestant in (every[::8] if options.small else every)
        for engine in ENGINES
    ]


def _weights(contestant: Contestant) -> str:
    agent = dict(contestant.settings).get("agent")
    if agent is None:
        return ""
    policy = contestant.policy(DEFAULT, {})
    return str(policy.describe().get("weights", ""))


def check_task(task: str, engine: Engine) -> None:
    """Raise a UsageError where an engine is not installed, or lacks the task."""
    variant = make_task(task, {"simulation": {"engine": engine}})
    with closing(EpisodeCore(variant)) as core:
        core.reset(np.random.default_rng(0))


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

    paths = sorted(_rows_folder(results).glob("*.csv.xz"))
    if not paths:
        raise UsageError(f"there are no rows in {_rows_folder(results)} to draw from")
    tables = {path.name.removesuffix(".csv.xz"): read_rows(path) for path in paths}
    summary = [row for task, rows in tables.items() for row in paired(task, rows)]
    write_csv(folder / TABLE, summary)
    write_csv(folder / AGREEMENT, agreement(summary))
    engines_figure(summary, folder / FIGURE)
    return summary
