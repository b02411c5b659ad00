"""From rows to the numbers of tables: a row per probe, or a row per setting."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from marl_mm.eval.grouping import by_goal, grouped, mean_of
from marl_mm.eval.intervals import (
    interval_of_mean,
    mean_interval,
    seed_rates,
    summarize_success,
)
from marl_mm.eval.metrics import Row, count_failures, failures_in_words
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.study import Cell, Study, cell_name
from marl_mm.sim.config import Engine

LEVELS = (0.70, 0.95)
"""Success rates to which episodes are counted; the paper's own ends at 70 %."""


@dataclass(frozen=True)
class CellRows:
    """The rows of a cell."""

    cell: Cell
    """Source and setting."""

    probes: Mapping[str, Sequence[Row]]
    """Evaluated goals by probe."""

    curves: Sequence[Row]
    """Points of the learning curves."""

    diverged: str
    """Seeds of runs that diverged, and after how many updates."""

    engines: Mapping[str, str] = field(default_factory=dict)
    """Engine of each probe with its version; empty where no rows name one."""


def summarize(
    study: Study, store: RowStore, seeds: Sequence[int], engine: Engine | None = None
) -> list[Row]:
    """The rows of a study's table.

    Args:
        study: The study.
        store: Rows of its cells.
        seeds: Seeds of the runs.
        engine: Engine that is asked for; None: that of the rows.

    Raises:
        UsageError: If rows of its cells are missing, or of another engine.
    """
    summary: list[Row] = []
    engines = store.engines(study.cells, engine)
    for cell in study.cells:
        of_cell = engines[cell_name(cell)]
        texts = {
            p.name: store.engine_text(cell, p.engine or of_cell) for p in study.probes
        }
        by_probe = grouped(store.evaluations(cell, seeds, study.probes), "probe")
        ends = store.diverged(cell)
        cell_rows = CellRows(
            cell,
            {probe.name: by_probe[probe.name] for probe in study.probes},
            store.curves(cell, seeds),
            ", ".join(f"{seed} after {ends[seed]}" for seed in seeds if seed in ends),
            {name: text for name, text in texts.items() if text},
        )
        if study.table == "episodes":
            summary.append(row_of_setting(cell_rows))
        else:
            summary += _by_probe(study, cell_rows)
    return summary


# --- A row per probe ---------------------------------------------------------


def _by_probe(study: Study, cell_rows: CellRows) -> list[Row]:
    of_runs: Row = {"diverged": cell_rows.diverged}
    for key in ("q_policy", "q_slope"):
        of_runs |= _at_the_end(cell_rows.curves, key)
    learnt = next((p for p in study.probes if p.alpha is None), study.probes[0])
    like = {**learnt.way, "alpha": None}
    held = {  # as it was evaluated, but for alpha
        p.alpha: cell_rows.probes[p.name]
        for p in study.probes
        if p.alpha is not None and {**p.way, "alpha": None} == like
    }
    worth = {}
    if learnt.alpha is None and held:
        worth = worth_of_alpha(cell_rows.probes[learnt.name], held)
    return [
        {**_of_probe(cell_rows, name), **of_runs, **worth} for name in cell_rows.probes
    ]


def _of_probe(cell_rows: CellRows, probe: str) -> Row:
    source, setting = cell_name(cell_rows.cell)
    rows, engine = cell_rows.probes[probe], cell_rows.engines.get(probe)
    rates = seed_rates(rows)
    summary: Row = {
        "dataset": source,
        "setting": setting,
        "probe": probe,
        **({} if engine is None else {"engine": engine}),
        "seeds": len(rates),
        "goals": len(rows) // len(rates),
        **summarize_success(rows, "success"),
        "success_seeds": " ".join(f"{100 * rate:.1f}" for rate in rates),
    }
    means = returns_of(rows).mean(axis=1)
    several = len(means) > 1
    summary["return_interval"] = mean_interval(means) if several else (np.nan, np.nan)
    for key in ("return", "d_mm", "d_mp", "alpha"):
        summary[key] = mean_of(rows, key) if key in rows[0] else np.nan
    failures = count_failures(rows)
    failed = {} if failures is None else {"failed": failures_in_words(failures)}
    return summary | failed


def returns_of(rows: Sequence[Row]) -> np.ndarray:
    """Returns of evaluated goals, shape (seeds, goals)."""
    return by_goal(rows, "return").reshape(len(grouped(rows, "seed")), -1)


def _at_the_end(curves: Sequence[Row], key: str) -> Row:
    """A critic's last value: mean over seeds where it is finite, and every seed's."""
    last = {row["seed"]: float(row.get(key, np.nan)) for row in curves}
    finite = [value for value in last.values() if np.isfinite(value)]
    every = "" if np.isnan(list(last.values())).all() else _listed(last.values())
    return {key: float(np.mean(finite)) if finite else np.nan, f"{key}_seeds": every}


def _listed(values: Iterable[float]) -> str:
    return " ".join(f"{value:.3g}".replace("e+0", "e").strip() for value in values)


def worth_of_alpha(learnt: Sequence[Row], held: Mapping[float, Sequence[Row]]) -> Row:
    """Return with the learnt alpha less that with the best one held.

    Paired by seed and goal; the interval is that of ``interval_of_mean``.
    """
    best = max(held, key=lambda alpha: float(returns_of(held[alpha]).mean()))
    difference = returns_of(learnt) - returns_of(held[best])
    return {
        "best_held": best,
        "over_held": float(difference.mean()),
        "over_held_interval": interval_of_mean(difference),
    }


# --- A row per setting -------------------------------------------------------


def row_of_setting(cell_rows: CellRows) -> Row:
    """Success at the end and at best, and the episodes that it took, of one cell."""
    by_seed = grouped(cell_rows.curves, "seed")
    row: Row = {"setting": cell_rows.cell[1].name}
    if cell_rows.engines:
        row["engine"] = next(iter(cell_rows.engines.values()))
    row["seeds"] = len(by_seed)
    for probe, goals in cell_rows.probes.items():
        row |= summarize_success(goals, f"success_{probe}")
        row[f"return_{probe}"] = mean_of(goals, "return")
    for level in LEVELS:
        counts = [episodes_to(by_seed[seed], level) for seed in sorted(by_seed)]
        row |= _counted(f"to_{round(100 * level)}", counts)
    row["episodes"] = max(point["episode"] for point in cell_rows.curves)
    return row


def episodes_to(curve: Sequence[Row], level: float) -> tuple[int, int] | None:
    """When a success rate was reached: between these two counts of episodes.

    They are of the last evaluation before the rate was first shown, 0 if there was
    none, and of the one that showed it; None if none did.
    """
    before = 0
    for row in sorted(curve, key=lambda row: row["episode"]):
        if row["success_all"] >= level:
            return before, row["episode"]
        before = row["episode"]
    return None


def _counted(name: str, counts: Sequence[tuple[int, int] | None]) -> Row:
    """Each seed's count, their mean and its interval; nan if one is missing.

    As a count is known to lie between two evaluations only, the interval reaches from
    the lower end of the earlier ones' to the upper end of the later ones'.
    """
    reached = [count for count in counts if count is not None]
    complete = len(reached) == len(counts)
    shown = [str(count[1]) if count else "-" for count in counts]
    row: Row = {f"{name}_seeds": " ".join(shown)}
    row[name] = float(np.mean([at for _, at in reached])) if complete else np.nan
    row[f"{name}_interval"] = (np.nan, np.nan)
    if complete and len(reached) > 1:
        low, _ = mean_interval([before for before, _ in reached])
        _, high = mean_interval([at for _, at in reached])
        row[f"{name}_interval"] = max(0.0, low), high
    return row
