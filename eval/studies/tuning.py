"""Tuning: as many settings for every offline algorithm, on data of no benchmark table.

Each algorithm has its preset and others drawn from ranges of its own, the same number,
updates, seeds and goals for all. The best mean over datasets and seeds is chosen.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.grouping import grouped, mean_of
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies.budgets import draw_budgets
from marl_mm.eval.studies.cells import (
    kept_rows,
    missing_groups,
    read_cells,
    run_cells,
)
from marl_mm.eval.studies.cost import GoalTimes, hours_table
from marl_mm.eval.studies.options import (
    StudyOptions,
    refuse_device,
    refuse_precision,
)
from marl_mm.eval.studies.tuning_cells import (
    TuningCell,
    cell_of,
    run_cell,
    seconds_per_update,
    settings_of,
)
from marl_mm.eval.studies.tuning_ranges import RANGES
from marl_mm.eval.tables import markdown_table
from marl_mm.progress import Bar
from marl_mm.received import read_json
from marl_mm.runs.recipes import RECIPES, build_dataset, named_card, refuse_unknown
from marl_mm.runs.settings import check_positive
from marl_mm.sim.config import RECORDED_ENGINE
from marl_mm.versions import engine_text

ABOUT = "Tuning: what each algorithm reaches with each of some settings."
"""Title."""

TABLE = "tuning.csv"
"""File of the table, a row per algorithm and setting."""

DATASETS = ("quiet-zone-noisy", "bar-one-bad")
"""Recipes of the datasets, which are not the benchmark's."""


@dataclass(frozen=True, kw_only=True)
class TuningOptions(StudyOptions):
    """Settings of the tuning."""

    algorithms: tuple[str, ...] = tuple(RANGES)
    """Registered names of the algorithms to tune; rows of others stay."""

    data: tuple[str, ...] = DATASETS
    """Names of the datasets, see "marl-mm datasets catalogue"; missing ones are
    built."""

    tried: int = 12
    """Number of settings of each algorithm, its preset among them."""

    updates: int = 5_000
    """Updates of every run."""

    goals: int = 50
    """Number of goals of every run's evaluation, the same for all."""

    def check_settings(self) -> None:
        """Raise for options that make no sense.

        Raises:
            UsageError: Naming the option.
        """
        refuse_device(self.device, "tuning trains on the CPU")
        super().check_settings()
        check_positive(tried=self.tried, updates=self.updates, goals=self.goals)
        refuse_unknown(self.data)
        refuse_precision(self.precision, "tuning has that of the presets")
        if self.engine not in (None, "mujoco"):
            raise UsageError(
                f"`engine` is {self.engine}, expected mujoco: the datasets' own"
            )
        for name in (*self.algorithms, *self.data):
            if (*self.algorithms, *self.data).count(name) > 1:
                raise UsageError(f"{name} is named twice, expected each once")
        for name in self.algorithms:
            if name not in RANGES:
                raise UsageError(
                    f"`algorithms` has {name!r}, expected some of {', '.join(RANGES)}"
                )


def cells_of(options: TuningOptions) -> dict[str, list[TuningCell]]:
    """Runs by algorithm."""
    seeds = tuple(options.seeds or (0, 1))
    tried, updates, goals, data = (
        (2, 20, 2, ("gate-expert",))  # which ships
        if options.small
        else (options.tried, options.updates, options.goals, options.data)
    )
    return {
        name: [
            cell_of(name, number, some, on, seeds, updates, goals)
            for (number, some), on in product(enumerate(settings_of(name, tried)), data)
        ]
        for name in options.algorithms
    }


def make_tuning(options: TuningOptions, bar: Bar) -> list[Row]:
    """Run what is missing, and draw the table.

    Returns:
        Rows of the table.

    Raises:
        UsageError: If an option makes no sense.
        KeyboardInterrupt: After Ctrl-C; finished runs are kept.
    """
    options.check_settings()
    cells = cells_of(options)
    rows_folder, runs = _rows_folder(options.results), options.runs_folder / "tuning"
    groups = missing_groups(
        {rows_folder / name: listed for name, listed in cells.items()},
        options.overwrite,
    )
    every = [cell for listed in groups.values() for cell in listed]
    kept = kept_rows(every, runs)
    for name in dict.fromkeys(cell.dataset for cell in every if cell not in kept):
        if not named_card(name)["ships"]:
            build_dataset(name, workers=options.workers, progress=bar)
    pool = options.workers, (bar, "tuning"), options.executor
    run_cells(run_cell, every, runs, *pool, groups)
    return draw_tuning(options.results, options.results)


def plan_tuning(options: TuningOptions, bar: Bar) -> str:
    """How many runs are missing, and hours if all goals take all steps, as Markdown.

    Raises:
        UsageError: If an option makes no sense.
    """
    options.check_settings()
    folder, goal_times = _rows_folder(options.results), GoalTimes()
    lines, every = [], cells_of(options)
    advance = bar("measuring", len(every))
    for name, cells in every.items():
        left: Sequence[TuningCell] = []
        if missing_groups({folder / name: cells}, options.overwrite):
            kept = kept_rows(cells, options.runs_folder / "tuning")
            left = [cell for cell in cells if cell not in kept]
        seconds = 0.0
        if left and not options.small:
            per_update = seconds_per_update(left[0])
            seconds = sum(
                len(cell.seeds) * cell.updates * per_update
                + len(cell.seeds) * cell.goals * goal_times(cell.task, cell.overrides)
                for cell in left
            )
        lines.append(((f"`{name}`",), len(left), len(cells), seconds))
        advance(1, name)
    return hours_table(("algorithm",), lines, options.workers, not options.small)


def _rows_folder(results: Path) -> Path:
    return results / "rows" / "tuning"


def draw_tuning(results: Path, folder: Path) -> list[Row]:
    """Write tables and curves into a folder, from rows in another.

    Returns:
        Rows of the table: a setting's mean success on each dataset and on all, its
        hyper-parameters, and whether it is chosen.

    Raises:
        UsageError: If there are no rows.
    """
    summary: list[Row] = []
    of_algorithms = read_cells(_rows_folder(results))
    for algorithm, rows in of_algorithms.items():
        record = _rows_folder(results) / f"{algorithm}.json"
        packages = read_json(record, MarlMmError)["packages"]
        tried = [
            _summed(algorithm, packages, *item)
            for item in grouped(rows, "setting").items()
        ]
        best = max(tried, key=lambda row: (row["success"], row["return"]))
        summary += [row | {"chosen": int(row is best)} for row in tried]
    write_csv(folder / TABLE, summary)
    every = [row for rows in of_algorithms.values() for row in rows]
    draw_budgets(every, _joined(row["engine"] for row in summary), folder)
    return summary


def _summed(
    algorithm: str, packages: Mapping[str, str], setting: int, rows: Sequence[Row]
) -> Row:
    of_data = grouped(rows, "dataset")
    made_by = [RECIPES.get(name).source.engine or RECORDED_ENGINE for name in of_data]
    engines = [engine_text(engine, packages) for engine in made_by]
    return {
        "algorithm": algorithm,
        "setting": setting,
        "success": mean_of(rows, "success"),
        "return": mean_of(rows, "return"),
        "seeds": len({row["seed"] for row in rows}),
        "engine": _joined(engines),
        "datasets": " ".join(of_data),
        "success_each": " ".join(
            f"{mean_of(some, 'success'):.3f}" for some in of_data.values()
        ),
        "changes": rows[0]["changes"],
    }


def _joined(texts: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(texts))


def tuning_table(rows: Sequence[Row]) -> str:
    """What each algorithm's preset reaches, and the chosen setting, as Markdown."""
    lines = []
    for algorithm, tried in grouped(rows, "algorithm").items():
        rates = [100 * row["success"] for row in tried]
        best = next(row for row in tried if row["chosen"])
        changes = json.loads(best["changes"]).items()
        lines.append(
            [
                f"`{algorithm}`",
                f"{rates[0]:.1f}",
                f"{np.median(rates):.1f}",
                f"{100 * best['success']:.1f}",
                ", ".join(f"`{n}` {v}" for n, v in changes) or "the preset",
            ]
        )
    header = ["algorithm", "preset [%]", "median setting [%]", "best [%]", "chosen"]
    return markdown_table(header, lines)
