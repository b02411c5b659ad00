"""Results of the alpha sweep: means over goals, and the worth of alpha."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from marl_mm.eval.intervals import bootstrap_interval, success_interval
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies.sweep_cells import SHORT_EPISODE

GAINED = ("zmp_margin", "zmp_fore_aft")
"""Columns with the gain over alpha 0."""


def summarize_cells(rows: Sequence[Row]) -> list[Row]:
    """One row per task, form, rule, alpha and direction: means over goals."""
    keys = sorted({_key(row) for row in rows})
    summaries = []
    for key in keys:
        own = [row for row in rows if _key(row) == key]
        task, form, rule, alpha, direction = key
        successes = [
            row["steps"] <= SHORT_EPISODE and row["success"] == 1 for row in own
        ]
        summaries.append(
            {
                "task": task,
                "form": form,
                "rule": rule,
                "alpha": alpha,
                "direction": direction,
                "goals": len(own),
                "d_mm": _mean(own, "d_mm"),
                "d_mp": _mean(own, "d_mp"),
                "steps": _mean(own, "steps"),
                "success_25": float(np.mean(successes)),
                "success_25_interval": success_interval(sum(successes), len(own)),
                "success_50": _mean(own, "success"),
                "base_jerk_rms": _mean(own, "base_jerk_rms"),
                "zmp_margin": min(row["zmp_margin"] for row in own),
                "return": _mean(own, "return"),
                "qp_failures": sum(row["qp_failures"] for row in own),
            }
        )
    return summaries


def _key(row: Row) -> tuple[str, str, str, float, str]:
    return row["task"], row["form"], row["rule"], row["alpha"], row["direction"]


def _mean(rows: Sequence[Row], name: str) -> float:
    return float(np.mean([row[name] for row in rows]))


def worth_of_a_rule(rows: Sequence[Row], task: str) -> list[Row]:
    """Return of each rule less that of every fixed alpha, paired by goal.

    With a 95 % bootstrap interval of the mean difference; rules and alphas have to have
    run on the same goals.
    """
    own = [row for row in rows if row["task"] == task]
    rules = sorted({(r["rule"], r["alpha"]) for r in own if r["rule"] != "constant"})
    alphas = sorted({row["alpha"] for row in own if row["rule"] == "constant"})
    found = []
    for rule, lowest in rules:
        with_rule = _returns(own, rule, lowest)
        for alpha in alphas:
            fixed = _returns(own, "constant", alpha)
            difference = np.array([with_rule[goal] - fixed[goal] for goal in fixed])
            low, high = bootstrap_interval(difference)
            found.append(
                {
                    "task": task,
                    "rule": rule,
                    "lowest_alpha": lowest,
                    "fixed_alpha": alpha,
                    "goals": len(difference),
                    "return_rule": float(np.mean(list(with_rule.values()))),
                    "return_fixed": float(np.mean(list(fixed.values()))),
                    "difference": float(difference.mean()),
                    "interval": [low, high],
                    "better_on": int((difference > 0).sum()),
                }
            )
    return found


def _returns(rows: Sequence[Row], rule: str, alpha: float) -> dict[int, float]:
    return {
        row["goal"]: row["return"]
        for row in rows
        if (row["rule"], row["alpha"]) == (rule, alpha)
    }


def summarize_loads(rows: Sequence[Row]) -> list[Row]:
    """One row per mass and alpha, with gains over alpha 0.

    Gains are paired by goal, and so is how much larger they are than with the least
    mass.
    """
    masses = sorted({row["mass"] for row in rows})
    alphas = sorted({row["alpha"] for row in rows})
    own = {
        (mass, alpha): sorted(
            (row for row in rows if (row["mass"], row["alpha"]) == (mass, alpha)),
            key=lambda row: row["goal"],
        )
        for mass in masses
        for alpha in alphas
    }
    means = ("success", "steps", "d_mm", "base_jerk_rms", "zmp_span", *GAINED)
    summary = []
    for (mass, alpha), of_cell in own.items():
        row: Row = {"mass": mass, "alpha": alpha, "goals": len(of_cell)}
        row |= {name: float(_column(of_cell, name).mean()) for name in means}
        for name in GAINED:
            gain, light = (
                _column(own[which, alpha], name) - _column(own[which, alphas[0]], name)
                for which in (mass, masses[0])
            )
            row[f"{name}_least"] = float(_column(of_cell, name).min())
            row[f"{name}_gain"] = float(gain.mean())
            row[f"{name}_gain_interval"] = bootstrap_interval(gain)
            row[f"{name}_more"] = float((gain - light).mean())
            row[f"{name}_more_interval"] = bootstrap_interval(gain - light)
        summary.append(row)
    return summary


def _column(rows: Sequence[Row], name: str) -> NDArray[np.float64]:
    return np.array([float(row[name]) for row in rows])
