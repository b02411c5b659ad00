"""From goals on both engines to paired differences, and to how far engines agree."""

from collections.abc import Sequence

import numpy as np

from marl_mm.eval.grouping import by_goal, grouped
from marl_mm.eval.intervals import bootstrap_interval, paired_interval
from marl_mm.eval.metrics import Row
from marl_mm.eval.tables import markdown_table

MEASURES = {
    "success": ("goals reached [%]", 100.0, ".1f"),
    "steps": ("steps", 1.0, ".2f"),
    "return": ("return", 1.0, ".2f"),
    "d_mm": ("d_mm [mm]", 1000.0, ".2f"),
    "d_mp": ("d_mp [mm]", 1000.0, ".2f"),
    "base_jerk_rms": ("jerk [m/s^3]", 1.0, ".2f"),
}
"""Headings, factors and formats of what is compared, by column."""

RANKED = ("success", "return")
"""Columns by which policies are ranked."""


def paired(task: str, rows: Sequence[Row]) -> list[Row]:
    """A row per policy: means on both engines, and the difference goal by goal.

    Args:
        task: Registered name of the task.
        rows: Rows of every policy, engine and goal; engines are in the order in which
            they first occur.
    """
    summary = []
    for policy, group in grouped(rows, "policy").items():
        (first, ours), (second, others) = grouped(group, "engine").items()
        row: Row = {"task": task, "policy": policy, "engine": first, "beside": second}
        row["goals"] = len(ours)
        for key in MEASURES:
            before, after = by_goal(ours, key), by_goal(others, key)
            row[key] = float(before.mean())
            row[f"{key}_beside"] = float(after.mean())
            row[f"{key}_difference"] = float((after - before).mean())
            row[f"{key}_difference_interval"] = (
                paired_interval(after, before)
                if key == "success"
                else bootstrap_interval(after - before)
            )
        summary.append(row)
    return summary


def agreement(summary: Sequence[Row]) -> list[Row]:
    """A row per task and ranked measure: how well one engine predicts the other."""
    return [
        {
            "task": task,
            "engine": group[0]["engine"],
            "beside": group[0]["beside"],
            "measure": key,
            "policies": len(group),
            **_agreement(*_columns(group, key)),
        }
        for task, group in grouped(summary, "task").items()
        for key in RANKED
    ]


def _columns(group: Sequence[Row], key: str) -> tuple[np.ndarray, np.ndarray]:
    values, others = ([row[k] for row in group] for k in (key, f"{key}_beside"))
    return np.array(values), np.array(others)


def _agreement(values: np.ndarray, others: np.ndarray) -> Row:
    low, high = float(values.min()), float(values.max())
    scale = high - low or 1.0
    return {
        "least": low,
        "most": high,
        "pearson": pearson(values, others),
        "mmrv": mean_maximum_rank_violation(values / scale, others / scale),
    }


def pearson(values: np.ndarray, others: np.ndarray) -> float:
    """Pearson's correlation; nan where one side does not vary."""
    if np.ptp(values) == 0 or np.ptp(others) == 0:
        return float("nan")
    return float(np.corrcoef(values, others)[0, 1])


def mean_maximum_rank_violation(values: np.ndarray, others: np.ndarray) -> float:
    """Mean over policies of the largest difference of two whose order is another.

    With R of the reference and S of the other engine, after Li et al. 2024 (SIMPLER):
    the mean over i of the maximum over j of |R_i - R_j| where (S_i < S_j) is not
    (R_i < R_j).

    Args:
        values: Means of the policies on the reference, shape (n,).
        others: Means on the other engine, shape (n,).
    """
    apart = np.abs(values[:, None] - values[None])
    violated = (values[:, None] < values[None]) != (others[:, None] < others[None])
    return float((apart * violated).max(axis=1).mean())


# --- Tables ------------------------------------------------------------------


def engines_table(summary: Sequence[Row]) -> str:
    """Both tables as Markdown: the first engine and the difference; the agreement."""
    header = ["task", "policy"]
    for head, _, _ in MEASURES.values():
        header += [head, "difference [95 %]"]
    lines = []
    for row in summary:
        line = [row["task"], row["policy"]]
        for key, (_, scale, form) in MEASURES.items():
            line.append(f"{scale * row[key]:{form}}")
            bounds = (row[f"{key}_difference"], *row[f"{key}_difference_interval"])
            mean, low, high = (f"{scale * value:+{form}}" for value in bounds)
            line.append(f"{mean} [{low}, {high}]")
        lines.append(line)
    agreed = agreement_table(agreement(summary))
    return f"{_engines(summary)}\n\n{markdown_table(header, lines)}\n{agreed}"


def agreement_table(rows: Sequence[Row]) -> str:
    """Correlation and rank violation per task and measure, as Markdown."""
    header = ("task", "of", "policies", "from", "to", "Pearson", "MMRV, of the range")
    lines = [
        (
            *(row["task"], row["measure"], str(row["policies"])),
            *(f"{row[key]:.3g}" for key in ("least", "most")),
            *(f"{row[key]:.3f}" for key in ("pearson", "mmrv")),
        )
        for row in rows
    ]
    return markdown_table(header, lines)


def _engines(summary: Sequence[Row]) -> str:
    pairs = {(row["engine"], row["beside"]) for row in summary}
    names = "; ".join(f"{first}, and {other} less it" for first, other in sorted(pairs))
    return f"Engines: {names}."
