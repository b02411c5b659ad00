"""How many updates are enough: the benchmark's runs beside others with fewer.

A run with few updates is the same run as one with many, stopped before: seeds and goals
are compared in pairs.
"""

from pathlib import Path

from marl_mm.errors import UsageError
from marl_mm.eval.intervals import interval_of_mean
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies import benchmark
from marl_mm.eval.studies.benchmark import ALGORITHM_NAMES, cells_of, of_cell
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.study import Study
from marl_mm.eval.tables import markdown_table
from marl_mm.progress import Bar

ABOUT = "Updates: the benchmark's algorithms after a quarter of theirs."
"""Title."""

TABLE = "early.csv"
"""File of the table: a row per dataset and algorithm."""

UPDATES = 5_000
"""Updates of the early ones."""

DATASETS = (
    *("quiet-zone-narrow", "quiet-zone-stitch"),
    *("gate-expert", "gate-stitch", "bar-conventions"),
)
"""Names of their recipes."""

_EARLY = cells_of(DATASETS, UPDATES, "early-")
_LATE = cells_of(DATASETS, benchmark.UPDATES)

AGENTS = Study("Table: the runs of both lengths.", (*_EARLY, *_LATE), seeds=5)
"""Study whose runs are compared."""


def make_early(options: StudyOptions, bar: Bar) -> list[Row]:
    """Draw the table from the rows of ``AGENTS`` that are there.

    Returns:
        Rows of the table.

    Raises:
        UsageError: If there are no rows.
    """
    return draw_early(options.results, options.results)


def draw_early(results: Path, folder: Path) -> list[Row]:
    """Write the table into a folder, from rows in another; likewise."""
    store, rows = RowStore(results / "rows"), list[Row]()
    for early, late in zip(_EARLY, _LATE, strict=True):
        seeds = sorted({*store.seeds(early)} & {*store.seeds(late)})
        if not seeds:
            continue
        before, reached_before = of_cell(store, early, seeds)
        after, reached_after = of_cell(store, late, seeds)
        gain = reached_after - reached_before
        rows.append(
            {name: after[name] for name in _HEAD}
            | {"early": before["success"], "late": after["success"]}
            | {"gain": gain.mean(), "gain_interval": interval_of_mean(gain)}
        )
    if not rows:
        raise UsageError(
            f"{store.folder} has no rows of both lengths: run marl-mm ablate early"
        )
    write_csv(folder / TABLE, rows)
    return rows


_HEAD = "dataset", "task", "algorithm", "engine", "seeds", "goals"
"""What the rows of both lengths share."""


def early_table(rows: list[Row]) -> str:
    """Goals reached [%] after few updates and after all, as Markdown.

    Bold where the gain's interval excludes 0.
    """
    datasets = dict.fromkeys(row["dataset"] for row in rows)
    texts = {(row["algorithm"], row["dataset"]): _text(row) for row in rows}
    lines = [
        [f"`{name}`", *(texts.get((name, dataset), "") for dataset in datasets)]
        for name in ALGORITHM_NAMES
        if any(row["algorithm"] == name for row in rows)
    ]
    heads = (dataset.removeprefix("marl_mm/") for dataset in datasets)
    seeds, engines = ({row[name] for row in rows} for name in ("seeds", "engine"))
    return (
        f"{markdown_table(['algorithm', *heads], lines)}\nOn "
        f"{' and '.join(sorted(engines))}; {min(seeds)} seeds or more.\n"
    )


def _text(row: Row) -> str:
    low, high = row["gain_interval"]
    text = f"{100 * row['early']:.0f} to {100 * row['late']:.0f}"
    return f"**{text}**" if low > 0 or high < 0 else text
