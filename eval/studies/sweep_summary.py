"""Results of the alpha sweep: means over goals, and the worth of alpha."""

from collections.abc import Sequence

from marl_mm.eval.grouping import by_goal, engine_in, grouped, mean_of
from marl_mm.eval.intervals import bootstrap_interval, success_interval
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies.sweep_cells import SHORT_EPISODE

GAINED = ("zmp_margin", "zmp_fore_aft")
"""Columns with the gain over alpha 0."""

_KEYS = ("task", "form", "rule", "alpha", "direction")


def summarize_cells(rows: Sequence[Row]) -> list[Row]:
    """One row per task, form, rule, alpha and direction: means over goals."""
    summaries = []
    for values, group in sorted(grouped(rows, *_KEYS).items()):
        successes = sum(
            row["steps"] <= SHORT_EPISODE and row["success"] == 1 for row in group
        )
        summaries.append(
            {
                **dict(zip(_KEYS, values, strict=True)),
                **engine_in(group),
                "goals": len(group),
                **{name: mean_of(group, name) for name in ("d_mm", "d_mp", "steps")},
                "success_25": successes / len(group),
                "success_25_interval": success_interval(successes, len(group)),
                "success_50": mean_of(group, "success"),
                "base_jerk_rms": mean_of(group, "base_jerk_rms"),
                "zmp_margin": min(row["zmp_margin"] for row in group),
                "return": mean_of(group, "return"),
                "qp_failures": sum(row["qp_failures"] for row in group),
            }
        )
    return summaries


def worth_of_a_rule(rows: Sequence[Row], task: str) -> list[Row]:
    """Return of each rule less that of every fixed alpha, paired by goal.

    With a 95 % bootstrap interval of the mean difference; rules and alphas have to have
    run on the same goals.
    """
    cells = grouped([row for row in rows if row["task"] == task], "rule", "alpha")
    worth = []
    for (rule, lowest), with_rule in sorted(cells.items()):
        for (kind, alpha), fixed in sorted(cells.items()):
            if rule == "constant" or kind != "constant":
                continue
            difference = by_goal(with_rule, "return") - by_goal(fixed, "return")
            worth.append(
                {
                    "task": task,
                    **engine_in(fixed),
                    "rule": rule,
                    "lowest_alpha": lowest,
                    "fixed_alpha": alpha,
                    "goals": len(difference),
                    "return_rule": mean_of(with_rule, "return"),
                    "return_fixed": mean_of(fixed, "return"),
                    "difference": float(difference.mean()),
                    "interval": bootstrap_interval(difference),
                    "better_on": int((difference > 0).sum()),
                }
            )
    return worth


def summarize_loads(rows: Sequence[Row]) -> list[Row]:
    """One row per mass and alpha, with gains over alpha 0.

    Gains are paired by goal, and so is how much larger they are than with the least
    mass.
    """
    cells = dict(sorted(grouped(rows, "mass", "alpha").items()))
    least_mass, least_alpha = next(iter(cells))
    means = ("success", "steps", "d_mm", "base_jerk_rms", "zmp_span", *GAINED)
    summary = []
    for (mass, alpha), group in cells.items():
        row: Row = {"mass": mass, "alpha": alpha, **engine_in(group)}
        row["goals"] = len(group)
        row |= {name: mean_of(group, name) for name in means}
        for name in GAINED:
            gain, light = (
                by_goal(cells[load, alpha], name)
                - by_goal(cells[load, least_alpha], name)
                for load in (mass, least_mass)
            )
            row[f"{name}_least"] = min(goal[name] for goal in group)
            row[f"{name}_gain"] = float(gain.mean())
            row[f"{name}_gain_interval"] = bootstrap_interval(gain)
            row[f"{name}_more"] = float((gain - light).mean())
            row[f"{name}_more_interval"] = bootstrap_interval(gain - light)
        summary.append(row)
    return summary
