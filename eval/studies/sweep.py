"""The alpha sweep: its cells are run, in several processes, and drawn."""

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from marl_mm.collectors.pd import PdConfig
from marl_mm.config_diff import as_json
from marl_mm.control.config import FORMS, Form
from marl_mm.envs.registry import make_task
from marl_mm.errors import MarlMmError, OutputExistsError, UsageError
from marl_mm.eval.grouping import grouped
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import has_rows, read_rows, write_csv
from marl_mm.eval.studies.cells import run_cells
from marl_mm.eval.studies.sweep_cells import (
    LONG_EPISODE,
    RUNS,
    SHORT_EPISODE,
    SweepCell,
    load_cells,
    run_cell,
)
from marl_mm.eval.studies.sweep_summary import (
    summarize_cells,
    summarize_loads,
    worth_of_a_rule,
)
from marl_mm.files import new_folder, only_here, refuse_foreign, write_json
from marl_mm.progress import Bar
from marl_mm.received import read_json
from marl_mm.runs.settings import check_positive, check_seed, refuse_both
from marl_mm.sim.config import Engine, default_engine, engine_overrides
from marl_mm.versions import versions

RULES = (PdConfig(alpha_rule="direction"), PdConfig(alpha_rule="room"))
"""State-dependent alphas, compared with every fixed one on SmoothReach-v0."""

SMOOTH = "SmoothReach-v0"

EPISODES, LOAD_EPISODES = "episodes.csv.xz", "load_episodes.csv.xz"

FINE = 0.05
"""Spacing of the fixed alphas that the rules are compared with."""

_TASKS = tuple(task for tasks in RUNS.values() for task in tasks)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Settings of the alpha sweep."""

    out: Path = Path("runs/alpha")
    """Folder of the results."""

    tasks: tuple[str, ...] = _TASKS
    """Tasks: Reach-v0, SmoothReach-v0, PreciseReach-v0."""

    forms: tuple[Form, ...] = FORMS
    """Forms in which alpha enters the controller: blend, rhp, rhp-literal."""

    goals: int = 48
    """Goals per alpha, half ahead and half behind."""

    alphas: int = 11
    """Number of alphas, evenly spaced from 0 to 1."""

    seed: int = 0
    """Seed of the goals."""

    worth_goals: int = 96
    """Goals for comparing rules with fixed alphas, of the next seed; 0: none."""

    engine: Engine = field(default_factory=default_engine)
    """Engine of the simulation: bullet or mujoco."""

    load_goals: int = 24
    """Goals per mass and alpha, for CarryReach-v0 with 0.1 to 3 kg in the hand; 0:
    none."""

    def check_settings(self) -> None:
        """Raise for a sweep that makes no sense.

        Raises:
            UsageError: Naming the setting.
        """
        check_positive(goals=self.goals)
        check_seed(self.seed)
        make_task(overrides=engine_overrides(self.engine))
        for name in ("goals", "worth_goals", "load_goals"):
            if (goals := getattr(self, name)) < 0 or goals % 2:
                raise UsageError(
                    f"`{name}` is {goals}, expected an even number: half ahead, half "
                    "behind"
                )
        if self.alphas < 2:
            raise UsageError(f"`alphas` is {self.alphas}, expected >= 2")
        allowed: dict[str, Sequence[str]] = {"tasks": _TASKS, "forms": FORMS}
        for name, choices in allowed.items():
            given = getattr(self, name)
            once = len({*given}) == len(given)
            if not given or not once or not {*given} <= {*choices}:
                raise UsageError(
                    f"`{name}` is {' '.join(given) or 'empty'}, expected some of "
                    f"{', '.join(choices)}, each once"
                )

    @property
    def cells(self) -> list[SweepCell]:
        """Fixed alphas in every form."""
        alphas = np.linspace(0, 1, self.alphas).round(6).tolist()
        return [
            SweepCell(task, form, PdConfig(alpha=alpha), self.goals, self.seed)
            for task, served in RUNS.items()
            if {*served} & {*self.tasks}
            for form in self.forms
            for alpha in alphas
        ]

    @property
    def worth_cells(self) -> list[SweepCell]:
        """Rules, and the fixed alphas they are compared with."""
        if not self.worth_goals or SMOOTH not in self.tasks:
            return []
        alphas = np.arange(0, 1 + FINE / 2, FINE).round(6).tolist()
        policies = [*(PdConfig(alpha=alpha) for alpha in alphas), *RULES]
        goals, seed = self.worth_goals, self.seed + 1
        return [
            SweepCell("Reach-v0", "blend", pd, goals, seed, SHORT_EPISODE)
            for pd in policies
        ]


_OLDER = "alpha.md", "*.svg", "drawn_with.txt"
"""Files that sweeps of version 1 have, too."""


def run_sweep(
    sweep: Sweep, workers: int, resume: bool, overwrite: bool, bar: Bar
) -> dict[str, list[Row]]:
    """Run a sweep, or the rest of it, and write its rows, tables and figures.

    Returns:
        Tables by name.

    Raises:
        UsageError: If something makes no sense, or the results exist.
        KeyboardInterrupt: After Ctrl-C, saying how to go on.
    """
    sweep.check_settings()
    check_positive(workers=workers)
    refuse_both(resume, overwrite)
    hidden = sweep.out.absolute().with_name(f".{sweep.out.absolute().name}.cells")
    swept = as_json(asdict(sweep) | {"out": sweep.out.name})
    if resume and not hidden.exists() and _options(sweep.out) == swept:
        with TemporaryDirectory() as drawn:
            return draw_sweep(sweep.out, Path(drawn))
    mark, files = ("config.json", '"options"'), ("*.csv", "*.csv.*", "*.png")
    begun = resume and hidden.exists()  # what is in OUT was to be replaced
    own = *_OLDER, "config.json", *files
    refuse_foreign(sweep.out, overwrite or begun, mark, own)
    if hidden.exists() and not (resume or overwrite):
        raise OutputExistsError(
            f"{sweep.out} was begun already: go on with `resume=True`, or start again "
            "with `overwrite=True`"
        )
    with only_here(hidden):
        if not resume:
            for older in hidden.iterdir():
                older.unlink()
        tables = _swept(sweep, hidden, workers, swept, bar)
        shutil.rmtree(hidden, ignore_errors=True)
    return tables


def _options(folder: Path) -> Any:
    """Options of the finished sweep in a folder; None without one."""
    file = folder / "config.json"
    values = read_json(file, MarlMmError) if file.exists() else None
    return values.get("options") if isinstance(values, dict) else None


def _swept(
    sweep: Sweep, hidden: Path, workers: int, options: dict[str, Any], bar: Bar
) -> dict[str, list[Row]]:
    """Run what a folder of cells lacks, and write everything; tables by name."""
    loads = load_cells(sweep.load_goals, sweep.seed) if sweep.load_goals else []
    cells, worth, loads = (
        [replace(cell, engine=sweep.engine) for cell in part]
        for part in (sweep.cells, sweep.worth_cells, loads)
    )
    every, shown = [*cells, *worth, *loads], (bar, "sweep-alpha")
    rows = run_cells(run_cell, every, hidden, workers, shown)
    kept = [row for cell in cells for row in rows[cell] if row["task"] in sweep.tasks]
    kept += [row for cell in worth for row in rows[cell] if row["task"] == SMOOTH]
    with new_folder(sweep.out) as folder:
        write_csv(folder / EPISODES, kept)
        if loads:
            write_csv(folder / LOAD_EPISODES, [r for cell in loads for r in rows[cell]])
        result = draw_sweep(folder, folder)
        record = {"options": options, "versions": versions()}
        write_json(folder / "config.json", record)
    return result


def draw_sweep(results: Path, folder: Path) -> dict[str, list[Row]]:
    """Write tables and figures of a sweep into a folder, from its rows in another.

    Returns:
        Tables by name.
    """
    from marl_mm.eval.figures import alpha_pareto, alpha_response, load_response

    rows = grouped(read_rows(results / EPISODES), "max_steps")
    carried = results / LOAD_EPISODES
    alphas = summarize_cells(rows[LONG_EPISODE])
    loads = summarize_loads(read_rows(carried)) if has_rows(carried) else []
    worth = worth_of_a_rule(rows.get(SHORT_EPISODE, []), SMOOTH)
    tables = {"alpha": alphas, "worth": worth, "loads": loads}
    for name, table in tables.items():
        if table:
            write_csv(folder / f"{name}.csv", table)
    alpha_response(alphas, folder / "response.png")
    alpha_pareto(alphas, folder / "pareto.png")
    if loads:
        load_response(loads, folder / "loads.png")
    return tables
