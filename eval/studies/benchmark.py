"""The benchmark: offline algorithms on datasets of all axes and of the team's tasks.

Of each dataset it tells which algorithms can be told apart, and over all datasets how
much of the goals each reaches, and how often it reaches more than another.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, groupby, product
from pathlib import Path

import numpy as np

from marl_mm.algorithms.chosen import CHOSEN, UPDATES
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.errors import UsageError
from marl_mm.eval.aggregates import (
    Estimate,
    improvement,
    interquartile,
    mean,
    resampled,
)
from marl_mm.eval.grouping import by_goal, grouped
from marl_mm.eval.intervals import summarize_success
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.settings import LAST, Setting, setting_of
from marl_mm.eval.studies.study import Cell, Study, cell_name
from marl_mm.eval.ties import tie_groups
from marl_mm.progress import Bar
from marl_mm.runs.recipes import RECIPES
from marl_mm.runs.sources import Source

ABOUT = "Benchmark: offline algorithms on datasets of the team's tasks."
"""Title."""

TABLE, OVERALL, PAIRS = (
    "benchmark.csv",
    "benchmark_overall.csv",
    "benchmark_pairs.csv",
)
"""Files of the tables: a row per dataset and algorithm, algorithm, or pair of them."""

ALGORITHM_NAMES = (
    *("bc", "mabc", "flow-bc", "ma-flow-bc", "ma-iql", "td3-bc", "matd3-bc"),
    *("ma-rebrac", "omar", "maicq", "mac-flow", "best-of-n", "q-chunking"),
)
"""Registered names of the algorithms."""

DATASETS = (
    *("quiet-zone-expert", "quiet-zone-narrow", "quiet-zone-rare"),
    *("quiet-zone-explore", "quiet-zone-stitch"),
    *("gate-expert", "gate-noisy", "gate-stitch", "tray-expert", "tray-explore"),
    *("moving-reach-explore", "moving-reach-one-bad"),
    *("bar-noisy", "bar-conventions", "course-expert", "course-noisy"),
)
"""Names of their recipes; none is of the tuning."""

EVALUATED_ON = {
    "quiet-zone-narrow": "QuietZone-v0",
    "quiet-zone-stitch": "QuietZone-v0",
    "gate-stitch": "Gate-v0",
}
"""Tasks that policies are evaluated on where it is not the data's, by recipe."""


def cells_of(
    names: Sequence[str],
    updates: int,
    prefix: str = "",
    algorithms: Sequence[str] = ALGORITHM_NAMES,
) -> tuple[Cell, ...]:
    """Cells of datasets and algorithms, as the tuning chose where they are tuned.

    Args:
        names: Names of the datasets' recipes.
        updates: Updates of all algorithms.
        prefix: Beginning of the settings' names.
        algorithms: Registered names of the algorithms.
    """
    return tuple(
        (
            RECIPES.get(name).source,
            _setting(algorithm, EVALUATED_ON.get(name), updates, prefix),
        )
        for name, algorithm in product(names, algorithms)
    )


def _setting(algorithm: str, task: str | None, updates: int, prefix: str) -> Setting:
    return setting_of(
        f"{prefix}{task or 'benchmark'}-{algorithm}".lower(),
        algorithm,
        updates,
        CHOSEN.get(algorithm, {}),
        task=task,
        curve_goals=2,
        measured=("steps", "return"),
    )


WHOLE = 5, 200
"""Seeds and goals of a cell that is whole."""

Scores = dict[str, np.ndarray]
"""Success by algorithm on a dataset, by seed and goal, shape (seeds, goals)."""


STUDY = Study(
    "Table: the benchmark's runs.", cells_of(DATASETS, UPDATES), seeds=WHOLE[0]
)
"""Study whose runs are compared: of algorithms that are tuned."""


@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions(StudyOptions):
    """Settings of the benchmark."""

    own: tuple[str, ...] = ()
    """Registered names of other offline algorithms, such as of a plug-in, which learn
    from the same data with what the tuning chose, or else by their tuned presets, with
    as many updates. Their rows in OUT stand in the tables while they are registered."""

    @property
    def study(self) -> Study:
        """Study whose runs are compared.

        Raises:
            UsageError: If an own algorithm is unknown, or does not learn from a
                dataset alone.
        """
        for name in self.own:
            if name not in (*ALGORITHM_NAMES, *_others()):
                learns = ALGORITHMS.get(name).learns
                raise UsageError(
                    f"`own` has {name}, which learns {learns}, expected an algorithm "
                    "that learns from a dataset"
                )
        every = tuple(dict.fromkeys((*ALGORITHM_NAMES, *self.own)))
        return replace(STUDY, cells=cells_of(DATASETS, UPDATES, algorithms=every))


def _others() -> list[str]:
    """Registered names of other algorithms that learn from a dataset."""
    names = (n for n, each in ALGORITHMS.items() if each.learns == "from a dataset")
    return sorted({*names} - {*ALGORITHM_NAMES})


def make_benchmark(options: StudyOptions, bar: Bar) -> list[Row]:
    """Draw the tables from the rows of ``STUDY`` that are there.

    Returns:
        Rows of the table of datasets and algorithms.

    Raises:
        UsageError: If there are no rows.
    """
    return draw_benchmark(options.results, options.results)


def draw_benchmark(results: Path, folder: Path) -> list[Row]:
    """Write the tables into ``folder``, from the rows below ``results``.

    Returns:
        Rows of the table of datasets and algorithms.

    Raises:
        UsageError: If there are no rows.
    """
    store, rows = RowStore(results / "rows"), list[Row]()
    scores: list[Scores] = []
    cells = cells_of(DATASETS, UPDATES, algorithms=(*ALGORITHM_NAMES, *_others()))
    for _, of_dataset in groupby(cells, lambda cell: cell_name(cell)[0]):
        seeds_of = [(cell, store.seeds(cell)) for cell in of_dataset]
        finished = [(cell, seeds) for cell, seeds in seeds_of if seeds]
        if not finished:
            continue
        results_of = [of_cell(store, cell, seeds) for cell, seeds in finished]
        store.refuse_mixed([cell for cell, _ in finished])
        success_of = {  # a single seed says nothing of the spread over seeds
            row["algorithm"]: success for row, success in results_of if row["seeds"] > 1
        }
        groups = dict(zip(success_of, tie_groups([*success_of.values()]), strict=True))
        best = max(success_of, key=lambda name: success_of[name].mean(), default="")
        for row, _ in results_of:
            own = groups.get(row["algorithm"], ())
            tied = {*own} & {*groups.get(best, ())} != set()
            row |= {"group": " ".join(map(str, own)), "first": int(tied)}
            rows.append(row)
        scores.append(success_of)
    if not rows:
        raise UsageError(
            f"{store.folder} has no rows of the benchmark: run marl-mm ablate benchmark"
        )
    write_csv(folder / TABLE, rows)
    _write_overall(folder, rows, scores)
    return rows


def of_cell(store: RowStore, cell: Cell, seeds: list[int]) -> tuple[Row, np.ndarray]:
    """A cell's row, and its success, shape (seeds, goals).

    Args:
        store: Rows.
        cell: The cell.
        seeds: Seeds that are there, sorted.
    """
    source, setting = cell
    assert isinstance(source, Source) and source.engine is not None
    rows = store.evaluations(cell, seeds, [LAST])
    success = by_goal(rows, "success").reshape(len(seeds), -1)
    row = {
        "dataset": source.name,
        "task": setting.task or source.task,
        "algorithm": setting.algorithm,
        "engine": store.engine_text(cell, source.engine),
        "seeds": len(seeds),
        "goals": success.shape[1],
        **summarize_success(rows, "success"),
    }
    return row, success


def _write_overall(folder: Path, rows: list[Row], scores: list[Scores]) -> None:
    """Write the tables over datasets, and of pairs of algorithms.

    Datasets count from which every one of the benchmark's algorithms that has rows
    anywhere has learnt with several seeds. Other algorithms are averaged over those of
    these datasets that they have learnt from.
    """
    compared = {name for success_of in scores for name in success_of}
    needed = compared & {*ALGORITHM_NAMES} or compared
    tables = zip(grouped(rows, "dataset").values(), scores, strict=True)
    whole = [(table, s) for table, s in tables if compared and s.keys() >= needed]
    names = in_order({name for _, success_of in whole for name in success_of})
    tasks = [table[0]["task"] for table, _ in whole]
    goals_of = [tasks.index(task) for task in tasks]  # a task has the same for all
    engine = ", ".join(sorted({row["engine"] for table, _ in whole for row in table}))
    means = {}
    for number, name in enumerate(in_order({*ALGORITHM_NAMES, *names})):
        places = [k for k, (_, success_of) in enumerate(whole) if name in success_of]
        success = [whole[k][1][name] for k in places]
        drawn = resampled(success, number, [goals_of[k] for k in places], places)
        means[name] = dict(zip(places, drawn, strict=True))
    firsts = [[row["algorithm"] for row in t if row["first"]] for t, _ in whole]
    overall = [
        {
            "algorithm": name,
            "datasets": len(means[name]),
            "engine": engine,
            **_estimated("iqm", interquartile([*means[name].values()])),
            **_estimated("mean", mean([*means[name].values()])),
            "first": sum(name in first for first in firsts),
            "first_alone": firsts.count([name]),
        }
        for name in names
    ]
    pairs = []
    for name, other in combinations(names, 2):
        shared = sorted(means[name].keys() & means[other].keys())
        if shared:
            of_both = ([means[each][k] for k in shared] for each in (name, other))
            row = {"algorithm": name, "other": other, "engine": engine}
            pairs.append(row | _estimated("improvement", improvement(*of_both)))
    write_csv(folder / OVERALL, overall)
    write_csv(folder / PAIRS, pairs)


def in_order(names: Collection[str]) -> list[str]:
    """Algorithms in the tables' order: others come last, by name."""
    listed = [*ALGORITHM_NAMES]
    return [n for n in listed if n in names] + sorted({*names} - {*listed})


def _estimated(name: str, estimate: Estimate) -> Row:
    value, *interval = estimate
    return {name: value, f"{name}_interval": tuple(interval)}
