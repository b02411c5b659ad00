"""What ablations of offline learning show: rows summarised, and as tables."""

from collections.abc import Iterable, Mapping, Sequence
from math import ceil

import numpy as np

from marl_mm.eval.ablation import (
    Ablation,
    Cell,
    Probe,
    Reported,
    Setting,
    cell_name,
)
from marl_mm.eval.ablations import LONG, reported
from marl_mm.eval.intervals import (
    difference_interval,
    interval_of_mean,
    mean_interval,
    seed_rates,
    success_interval,
    summarize_success,
)
from marl_mm.eval.metrics import Row, count_failures, failures_in_words
from marl_mm.eval.offline_rows import RowStore
from marl_mm.eval.tables import (
    markdown_table,
    percent_with_interval,
    rate_with_deviation,
    rate_with_interval,
    without,
)

COLUMNS = {
    "q_policy": "critic's value, every seed",
    "q_slope": "critic's slope, every seed",
}
"""Headings of what the critics say of the policy's actions, and how much more they
value going to the goal than away from it; no return can pass 10."""

RETURN = "return [95 %]"
"""Heading of a mean over seeds and goals, with Student's interval over seeds."""

OVER_HELD = "return over the best alpha held [95 %]"
"""Heading of what the learnt alpha is worth."""

FAILED = "failed"
"""Heading of how many episodes of all seeds failed, and why, where they can."""


def summarize_ablation(
    ablation: Ablation, store: RowStore, seeds: Sequence[int]
) -> list[Row]:
    """One row per cell and probe.

    Args:
        ablation: What it is of.
        store: Has the rows.
        seeds: Of the runs that count.
    """
    summary = []
    for cell in ablation.cells:
        rows = store.evaluations(cell, seeds, ablation.probes)
        curves = store.curves(cell, seeds)
        of_runs: Row = {"diverged": _diverged(store.diverged(cell), seeds)}
        for key in COLUMNS:
            of_runs |= _at_the_end(curves, key)
        by_probe = {
            probe.name: [row for row in rows if row["probe"] == probe.name]
            for probe in ablation.probes
        }
        first, *others = ablation.probes
        held = {p.alpha: by_probe[p.name] for p in others if p.alpha is not None}
        worth = worth_of_alpha(by_probe[first.name], held) if held else {}
        for probe in ablation.probes:
            own = _summarize(cell, probe, by_probe[probe.name])
            summary.append(own | of_runs | worth)
    return summary


def worth_of_alpha(learnt: Sequence[Row], held: Mapping[float, Sequence[Row]]) -> Row:
    """Return with the learnt alpha less that with the best one held.

    Paired by seed and goal; the interval is that of ``interval_of_mean``.

    Args:
        learnt: Evaluated episodes.
        held: The same seeds and goals, by the alpha held.
    """
    best = max(held, key=lambda alpha: float(_returns(held[alpha]).mean()))
    difference = _returns(learnt) - _returns(held[best])
    return {
        "best_held": best,
        "over_held": float(difference.mean()),
        "over_held_interval": interval_of_mean(difference),
    }


def _returns(rows: Sequence[Row]) -> np.ndarray:
    """Of evaluated episodes, shape (seeds, goals)."""
    ordered = sorted(rows, key=lambda row: (row["seed"], row["goal"]))
    seeds = len({row["seed"] for row in rows})
    return np.array([row["return"] for row in ordered]).reshape(seeds, -1)


def _at_the_end(curves: Sequence[Row], key: str) -> Row:
    """What the critics say, mean over seeds and every seed's; nan where there are none.

    The mean is that of the finite ones.
    """
    last = {row["seed"]: float(row[key]) for row in curves}
    known = [value for value in last.values() if np.isfinite(value)]
    every = "" if np.isnan(list(last.values())).all() else _listed(last.values())
    return {key: float(np.mean(known)) if known else np.nan, f"{key}_seeds": every}


def differences(
    ablation: Ablation, store: RowStore, baseline: str
) -> dict[tuple[str, str], Row]:
    """By how much cells are better than a setting on the same dataset.

    Args:
        ablation: Of whose cells, at the first probe.
        store: Has the rows.
        baseline: Name of that setting.

    Returns:
        By names of dataset and setting ``success`` and ``return``, means over seeds
        less the baseline's, each with its ``_interval``, Welch's.
    """
    seeds, found = range(ablation.seeds), {}
    means: dict[tuple[str, str], dict[str, Sequence[float]]] = {}
    for cell in ablation.cells:
        rows = store.evaluations(cell, seeds, ablation.probes[:1])
        of_returns = _returns(rows).mean(axis=1).tolist()
        means[cell_name(cell)] = {"success": seed_rates(rows), "return": of_returns}
    for (dataset, setting), ours in means.items():
        if setting == baseline:
            continue
        row: Row = {}
        for key, theirs in means[dataset, baseline].items():
            row[key] = float(np.mean(ours[key]) - np.mean(theirs))
            row[f"{key}_interval"] = difference_interval(ours[key], theirs)
        found[dataset, setting] = row
    return found


def _listed(values: Iterable[float]) -> str:
    return " ".join(f"{value:.3g}".replace("e+0", "e").strip() for value in values)


def _diverged(updates: Mapping[int, int], seeds: Sequence[int]) -> str:
    told = (f"{seed} after {updates[seed]}" for seed in seeds if seed in updates)
    return ", ".join(told)


def _summarize(cell: Cell, probe: Probe, rows: Sequence[Row]) -> Row:
    dataset, setting = cell
    rates = seed_rates(rows)
    summary: Row = {
        "dataset": dataset,
        "setting": setting.name,
        "probe": probe.name,
        "seeds": len(rates),
        "goals": len(rows) // len(rates),
        **summarize_success(rows, "success"),
        "success_seeds": " ".join(f"{100 * rate:.1f}" for rate in rates),
    }
    means = _returns(rows).mean(axis=1)
    known = len(means) > 1
    summary["return_interval"] = mean_interval(means) if known else (np.nan, np.nan)
    for key in ("return", "d_mm", "d_mp", "alpha"):
        summary[key] = float(np.mean([row[key] for row in rows]))
    failures = count_failures(rows)
    told = {} if failures is None else {"failed": failures_in_words(failures)}
    return summary | told


def goals_for(rate: float, half_width: float) -> int:
    """Goals from which on Wilson's 95 % interval reaches no further to either side.

    Args:
        rate: Of success.
        half_width: How far.
    """

    def reach(goals: int) -> float:
        reached = round(rate * goals)
        low, high = success_interval(reached, goals)
        return max(high - reached / goals, reached / goals - low)

    most = ceil(1 / half_width**2)  # Wilson's is less than 1 / sqrt(goals) by far
    return 1 + max(goals for goals in range(1, most) if reach(goals) > half_width)


# --- Tables ------------------------------------------------------------------


def ablation_table(
    ablation: Ablation, summary: Sequence[Row], leave_out: Sequence[str] = ()
) -> str:
    """One row per cell, as Markdown, without some columns; see ``ablation_lines``."""
    return markdown_table(*without(*ablation_lines(ablation, summary), leave_out))


def ablation_lines(
    ablation: Ablation, summary: Sequence[Row]
) -> tuple[list[str], list[list[str]]]:
    """Header and lines of a table: the first probe in full, of others what changes."""
    first, *others = ablation.probes
    known = {(row["dataset"], row["setting"], row["probe"]): row for row in summary}
    header = ["dataset", "setting", f"goals reached [%], {first.about}", "every seed"]
    header += ["IQM [%]", *(_told(probe) for probe in others)]
    header += ["paper [%]", "difference [points]"]
    header += [RETURN, "d_mm [m]", "d_mp [m]", "alpha", *COLUMNS.values()]
    held = any(probe.alpha is not None for probe in others)
    header += [OVER_HELD] * held
    can_fail = any("failed" in row for row in summary)
    header += [FAILED] * can_fail
    lines = []
    for dataset, setting in ablation.cells:
        row = known[dataset, setting.name, first.name]
        line = [dataset, setting.about, rate_with_interval(row)]
        line += [_every_seed(row)]
        line += [percent_with_interval(row["success_iqm"], row["success_iqm_interval"])]
        line += [
            _short(known[dataset, setting.name, probe.name], probe) for probe in others
        ]
        theirs = ablation.reported.get((dataset, setting.name))
        line += _beside(theirs or reported((dataset, setting)), setting, row)
        line += [_return(row)]
        line += [f"{row['d_mm']:.3f}", f"{row['d_mp']:.3f}", f"{row['alpha']:.2f}"]
        line += [_in_a_row(row[f"{key}_seeds"]) for key in COLUMNS]
        line += [_over_held(row)] if held else []
        line += [row.get("failed", "")] if can_fail else []
        lines.append(line)
    return header, lines


def _over_held(row: Row) -> str:
    low, high = row["over_held_interval"]
    told = f"{row['over_held']:+.2f} [{low:+.2f}, {high:+.2f}]"
    return f"{told} over {row['best_held']:g}"


def _return(row: Row) -> str:
    low, high = row["return_interval"]
    interval = "" if np.isnan(low) else f" [{low:.2f}, {high:.2f}]"
    return f"{row['return']:.2f}{interval}"


def _in_a_row(values: str | float) -> str:
    """Numbers apart by commas; a single one may have been read as such."""
    return str(values).replace(" ", ", ")


def _every_seed(row: Row) -> str:
    rates = _in_a_row(row["success_seeds"])
    return f"{rates}; diverged: {row['diverged']}" if row["diverged"] else rates


def _told(probe: Probe) -> str:
    return probe.about if probe.alpha is None else f"{probe.about}: goals [%], return"


def _short(row: Row, probe: Probe) -> str:
    if probe.alpha is None:
        return rate_with_interval(row)
    return f"{rate_with_deviation(row)}, {row['return']:.2f}"


def _beside(theirs: Reported | None, setting: Setting, row: Row) -> list[str]:
    """What others report, and ours less that; the paper's are of long runs."""
    if theirs is None:
        return ["", ""]
    if theirs.success is None or setting.config.updates != LONG:
        return [str(theirs), ""]
    return [str(theirs), f"{100 * row['success'] - theirs.success:+.1f}"]


def differences_table(ablation: Ablation, rows: Mapping[tuple[str, str], Row]) -> str:
    """What ``differences`` found, a line per cell, as Markdown."""
    about = {setting.name: setting.about for _, setting in ablation.cells}

    def told(row: Row, key: str, scale: float, digits: int) -> str:
        values = (scale * value for value in (row[key], *row[f"{key}_interval"]))
        mean, low, high = (f"{value:+.{digits}f}" for value in values)
        return f"{mean} [{low}, {high}]"

    lines = [
        [dataset, about[name], told(row, "success", 100, 1), told(row, "return", 1, 2)]
        for (dataset, name), row in rows.items()
    ]
    header = ["dataset", "setting", "goals reached [points, 95 %]", RETURN]
    return markdown_table(header, lines)


def goals_table(half_width: float = 0.05) -> str:
    """How many goals an interval of +- so much needs, by success rate, as Markdown."""
    rates = (0.5, 0.7, 0.8, 0.9, 0.95, 1.0)
    header = [f"at {100 * rate:.0f} %" for rate in rates]
    goals = [str(goals_for(rate, half_width)) for rate in rates]
    return markdown_table(["goals reached", *header], [["goals needed", *goals]])
