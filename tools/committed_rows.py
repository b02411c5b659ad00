"""Committed results that reference pages show: rows of studies, by algorithm."""

from pathlib import Path
from typing import Any

from result_tables import recorded_engines

from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies.baselines import DATASETS
from marl_mm.eval.studies.fine_tuning import FINE_TUNING
from marl_mm.eval.studies.online import CELLS
from marl_mm.eval.studies.settings import Online
from marl_mm.eval.studies.study import cell_name
from marl_mm.eval.studies.targets import STUDIES
from marl_mm.runs.recipes import RECIPES
from marl_mm.runs.sources import Source

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "eval/results"
Row = dict[str, Any]

DATA = {
    "smooth-30k": "SmoothReach-v0",
    "precise-30k": "PreciseReach-v0",
    "marl_mm/carry-reach/scripted-v0": "CarryReach-v0",
    "marl_mm/grasp/scripted-v0": "Grasp-v0",
    "marl_mm/grasp-reach/scripted-v0": "GraspReach-v0",
    **{
        source.name: source.task for source in (RECIPES.get(n).source for n in DATASETS)
    },
}
"""Tasks of the datasets of committed offline results; of the others, Reach-v0."""

NAMES = {name: found.title for name, found in ALGORITHMS.items()}
"""Names of algorithms as papers write them."""


def offline_rows() -> list[Row]:
    """Rows of the last checkpoints of tuned runs, on every dataset."""
    rows = [
        row
        for table in ("offline", "tasks", "blocks")
        for row in read_rows(RESULTS / f"studies/{table}.csv")
    ]
    return [row for row in rows if row["probe"] == "last"]


def baseline_rows(name: str) -> list[Row]:
    """Rows of an algorithm on the datasets of ``ablate baselines``."""
    rows = read_rows(RESULTS / "studies/baselines.csv")
    return [row for row in rows if row["setting"] == f"{name}-baseline"]


def benchmark_rows(name: str) -> list[Row]:
    """Rows of an algorithm in the benchmark."""
    rows = read_rows(RESULTS / "studies/benchmark.csv")
    return [row for row in rows if row["algorithm"] == name]


def benchmark_mean(name: str) -> Row:
    """An algorithm's row over all datasets of the benchmark."""
    rows = read_rows(RESULTS / "studies/benchmark_overall.csv")
    return next(row for row in rows if row["algorithm"] == name)


def fine_tuning_rows(name: str) -> list[Row]:
    """Rows of an algorithm that goes on online from data, with their tasks."""
    tasks = {
        cell_name(cell): cell[0].task
        for cell in FINE_TUNING.cells
        if isinstance(cell[0], Source) and cell[1].algorithm == name
    }
    return [
        {**row, "task": tasks[row["dataset"], row["setting"]]}
        for row in read_rows(RESULTS / "studies/fine-tuning.csv")
        if (row["dataset"], row["setting"]) in tasks
    ]


def online_rows() -> list[Row]:
    """Rows of online learning by this package's algorithms, with its task."""
    rows = []
    cells = {**CELLS}
    for source, setting in STUDIES["grasp"].cells:
        assert isinstance(source, Online)
        cells[setting.name] = source, setting
    every = [
        row
        for name in ("online", "grasp")
        for row in read_rows(RESULTS / f"studies/{name}.csv")
    ]
    for row in every:
        source, setting = cells[row["setting"]]
        if setting.library == "marl_mm":
            columns = {"algorithm": setting.algorithm, "about": setting.about}
            rows.append({**row, **columns, "task": source.task})
    return rows


def engine_named(row: Row) -> str:
    """Engine of a committed row and its version."""
    return row.get("engine") or recorded_engines()


def task_of(row: Row) -> str:
    """Name of the task whose dataset a row of offline learning is about."""
    return DATA.get(row["dataset"], "Reach-v0")
