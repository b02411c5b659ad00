"""Tables of pages about the alpha sweep."""

from collections.abc import Iterable, Sequence

import numpy as np

from marl_mm.eval.metrics import Row
from marl_mm.eval.tables import markdown_table

ALPHA_HEADER = (
    "alpha",
    "hand d_mm [mm]",
    "base d_mp [mm]",
    "base jerk [m/s^3]",
    "steps",
    "within 25",
    "within 50",
    "return",
    "ZMP margin [m]",
)


def alpha_table(summaries: Sequence[Row], task: str, form: str) -> str:
    """One row per fixed alpha, as Markdown; pairs are backward, forward."""
    by_alpha = {
        (row["alpha"], row["direction"]): row
        for row in summaries
        if (row["task"], row["form"], row["rule"]) == (task, form, "constant")
    }
    lines = []
    for alpha in sorted({alpha for alpha, _ in by_alpha}):
        pair = [by_alpha[alpha, way] for way in ("backward", "forward")]
        goals = sum(row["goals"] for row in pair)
        total = sum(row["goals"] * row["return"] for row in pair)
        lines.append(
            (
                f"{alpha:g}",
                _pair("{:.1f}", (1e3 * row["d_mm"] for row in pair)),
                _pair("{:.1f}", (1e3 * row["d_mp"] for row in pair)),
                _pair("{:.2f}", (row["base_jerk_rms"] for row in pair)),
                _pair("{:.1f}", (row["steps"] for row in pair)),
                _pair("{:.0f}", (100 * row["success_25"] for row in pair)) + " %",
                _pair("{:.0f}", (100 * row["success_50"] for row in pair)) + " %",
                f"{total / goals:.2f}",
                f"{min(row['zmp_margin'] for row in pair):.3f}",
            )
        )
    return markdown_table(ALPHA_HEADER, lines)


def _pair(form: str, values: Iterable[float]) -> str:
    return ", ".join(form.format(value) for value in values)


def responses(summaries: Sequence[Row]) -> list[Row]:
    """How evenly the robot answers to alpha, a row per task and form.

    ``largest_share`` is of the whole change in steps going backward, made by one step
    of the alpha grid, from alpha ``at`` on. ``d_mm_falls`` and ``d_mp_rises`` are the
    largest changes the wrong way from one alpha to the next [m]; ``hump`` is the
    forward d_mm at its worst alpha, beyond the larger of both ends' [m].
    """
    fixed = [row for row in summaries if row["rule"] == "constant"]
    summary = []
    for task, form in sorted({(row["task"], row["form"]) for row in fixed}):
        group = [row for row in fixed if (row["task"], row["form"]) == (task, form)]
        group.sort(key=lambda row: float(row["alpha"]))
        back = [row for row in group if row["direction"] == "backward"]
        steps = np.array([row["steps"] for row in back])
        shares = np.diff(steps) / max(steps[-1] - steps[0], 1e-9)
        hand = [row["d_mm"] for row in group if row["direction"] == "forward"]
        summary.append(
            {
                "task": task,
                "form": form,
                "largest_share": float(shares.max()),
                "at": back[int(shares.argmax())]["alpha"],
                "d_mm_falls": float(-np.diff([row["d_mm"] for row in back]).min()),
                "d_mp_rises": float(np.diff([row["d_mp"] for row in back]).max()),
                "hump": float(max(hand) - max(hand[0], hand[-1])),
            }
        )
    return summary


def response_table(responses: Sequence[Row]) -> str:
    """How evenly each form answers to alpha, as Markdown."""
    header = (
        *("task", "form", "largest share of one alpha step", "at alpha"),
        *("d_mm falls by [m]", "d_mp rises by [m]", "hump ahead [m]"),
    )
    lines = [
        (
            row["task"],
            row["form"],
            f"{100 * row['largest_share']:.0f} %",
            f"{row['at']:g}",
            *(f"{max(row[k], 0):.4f}" for k in ("d_mm_falls", "d_mp_rises", "hump")),
        )
        for row in responses
    ]
    return markdown_table(header, lines)


def worth_table(worth: Sequence[Row]) -> str:
    """Each rule against the best fixed alpha and against all, as Markdown."""
    header = (
        "rule",
        "lowest alpha",
        "goals",
        "return",
        "best fixed alpha",
        "its return",
        "difference [95 % interval]",
        "better on",
        "least lower end against any fixed alpha",
    )
    lines = []
    for rule in sorted({row["rule"] for row in worth}):
        group = [row for row in worth if row["rule"] == rule]
        best = max(group, key=lambda row: float(row["return_fixed"]))
        low, high = best["interval"]
        lines.append(
            (
                rule,
                f"{best['lowest_alpha']:g}",
                str(best["goals"]),
                f"{best['return_rule']:.2f}",
                f"{best['fixed_alpha']:g}",
                f"{best['return_fixed']:.2f}",
                f"{best['difference']:.2f} [{low:.2f}, {high:.2f}]",
                f"{best['better_on']}/{best['goals']}",
                f"{min(row['interval'][0] for row in group):.2f}",
            )
        )
    return markdown_table(header, lines)


def load_table(summary: Sequence[Row]) -> str:
    """A mass a row, as Markdown: margins at both ends of alpha, and gains."""
    header = (
        "load [kg]",
        "goals",
        "reached, alpha 0, 1",
        "to any edge, alpha 0, 1 [mm]",
        "gained [95 % interval]",
        "more than with the least load",
        "to the front or rear edge, alpha 0, 1 [mm]",
        "gained [95 % interval]",
        "more than with the least load",
        "swing, alpha 0, 1 [mm]",
    )
    lines = []
    for mass in sorted({row["mass"] for row in summary}):
        group = [row for row in summary if row["mass"] == mass]
        ends = group[0], group[-1]
        line = [
            f"{mass:g}",
            str(ends[0]["goals"]),
            _pair("{:.0f}", (100 * row["success"] for row in ends)) + " %",
        ]
        for name in ("zmp_margin", "zmp_fore_aft"):
            line += [
                _pair("{:.0f}", (1000 * row[name] for row in ends)),
                _in_mm(ends[1], f"{name}_gain"),
                _in_mm(ends[1], f"{name}_more"),
            ]
        line.append(_pair("{:.0f}", (1000 * row["zmp_span"] for row in ends)))
        lines.append(tuple(line))
    return markdown_table(header, lines)


def _in_mm(row: Row, name: str) -> str:
    value, *ends = (1000 * x for x in (row[name], *row[f"{name}_interval"]))
    return "{:.1f} [{:.1f}, {:.1f}]".format(value, *ends)
