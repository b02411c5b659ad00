"""How many updates are enough: the benchmark's runs beside others with fewer.

Runs of both lengths have the same seeds and goals, and are compared in pairs. Where
their precision is the same, too, the shorter one is the longer one's beginning.
"""

from dataclasses import replace
from pathlib import Path

from marl_mm.algorithms import chosen
from marl_mm.errors import UsageError
from marl_mm.eval.intervals import interval_of_gain
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies.benchmark import WHOLE, cells_of, of_cell
from marl_mm.eval.studies.benchmark_tables import algorithms_table
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.study import Study
from marl_mm.progress import Bar

ABOUT = "Updates: the benchmark's algorithms after a quarter of theirs."
"""Title."""

TABLE = "early.csv"
"""File of the table: a row per dataset and algorithm."""

UPDATES = 5_000
"""Updates of the shorter runs."""

DATASETS = (
    *("quiet-zone-narrow", "quiet-zone-stitch"),
    *("gate-expert", "gate-stitch", "bar-conventions", "moving-reach-explore"),
)
"""Names of their recipes."""

_EARLY = tuple(
    (
        source,
        replace(of, changes={"updates": UPDATES}) if of.algorithm == "omar" else of,
    )
    for source, of in cells_of(DATASETS, UPDATES, "early-")
)
"""Cells of few updates; OMAR's are of its preset, as they were before it was tuned."""

_LATE = cells_of(DATASETS, chosen.UPDATES)

STUDY = Study("Table: the runs of both lengths.", (*_EARLY, *_LATE), seeds=WHOLE[0])
"""Study whose runs are compared."""


def make_early(options: StudyOptions, bar: Bar) -> list[Row]:
    """Draw the table from the rows of ``STUDY`` that are there.

    Returns:
        Rows of the table.

    Raises:
        UsageError: If there are no rows of both lengths.
    """
    return draw_early(options.results, options.results)


def draw_early(results: Path, folder: Path) -> list[Row]:
    """Write the table into ``folder``, from the rows below ``results``.

    Raises:
        UsageError: If there are no rows of both lengths.
        OtherConfigError: If those of one length are of other data, goals or engine.
    """
    store, rows = RowStore(results / "rows"), list[Row]()
    for early, late in zip(_EARLY, _LATE, strict=True):
        seeds = sorted({*store.seeds(early)} & {*store.seeds(late)})
        if not seeds:
            continue
        store.refuse_mixed((early, late), but="updates")
        before, reached_before = of_cell(store, early, seeds)
        after, reached_after = of_cell(store, late, seeds)
        gain = reached_after - reached_before
        of_both = {"early": before["success"], "gain": gain.mean()}
        rows.append({**after, **of_both, "gain_interval": interval_of_gain(gain)})
    if not rows:
        raise UsageError(
            f"{store.folder} has no rows of both lengths: run marl-mm ablate early"
        )
    write_csv(folder / TABLE, rows)
    return rows


def early_table(rows: list[Row]) -> str:
    """Goals reached [%] after few updates and after all, as Markdown.

    Bold where the interval of what several seeds gain excludes 0.
    """
    engines = " and ".join(sorted({row["engine"] for row in rows}))
    return f"{algorithms_table(rows, _text)}\nOn {engines}.\n"


def _text(row: Row) -> str:
    low, high = row["gain_interval"]
    text = f"{100 * row['early']:.1f}, then {100 * row['success']:.1f}"
    apart = row["seeds"] > 1 and (low > 0 or high < 0)
    parts = [f"**{text}**" if apart else text]
    numbers = row["seeds"], row["goals"]
    return "; ".join(parts + ["{} x {}".format(*numbers)] * (numbers != WHOLE))
