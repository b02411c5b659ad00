"""Evaluations and sweeps as Markdown, as CSV or on the terminal."""

import csv
from collections.abc import Sequence
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.table import Table

from marl_mm.eval.evaluate import Evaluation
from marl_mm.eval.metrics import Row
from marl_mm.eval.sweep import Response
from marl_mm.files import new_file

HEADER = (
    "policy",
    "goals",
    "success % [95 % interval]",
    "steps",
    "return",
    "d_mm [m]",
    "d_mp [m]",
    "jerk [m/s^3]",
    "alpha",
)

_DIRECTIONS = ("all", "forward", "backward")


def table_rows(evaluations: Sequence[Evaluation]) -> list[tuple[str, ...]]:
    """One row per policy and direction, formatted."""
    rows: list[tuple[str, ...]] = []
    for evaluation in evaluations:
        for direction in _DIRECTIONS:
            summary = evaluation.summary.get(direction)
            if summary is None:
                continue
            low, high = (100 * bound for bound in summary["interval"])
            steps = summary["steps_to_success"]
            rows.append(
                (
                    evaluation.policy,
                    f"{summary['episodes']} {direction}",
                    f"{100 * summary['success_rate']:.1f} [{low:.1f}, {high:.1f}]",
                    "-" if steps is None else f"{steps:.1f}",
                    f"{summary['return']:.2f}",
                    f"{summary['d_mm']:.3f}",
                    f"{summary['d_mp']:.3f}",
                    f"{summary['base_jerk_rms']:.2f}",
                    f"{summary['alpha']:.2f}",
                )
            )
    return rows


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def evaluation_markdown(evaluations: Sequence[Evaluation]) -> str:
    """Evaluations as a Markdown table."""
    return markdown_table(HEADER, table_rows(evaluations))


def evaluation_table(evaluations: Sequence[Evaluation]) -> Table:
    """Evaluations as a table for a terminal of 80 columns."""
    table = Table(box=SIMPLE_HEAD, padding=0, pad_edge=False)
    for column, name in enumerate(HEADER):
        short = name.split(" [")[0]
        table.add_column(short, justify="left" if column < 2 else "right", no_wrap=True)
    for row in table_rows(evaluations):
        table.add_row(*row, end_section=row[1].endswith(_DIRECTIONS[-1]))
    return table


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Rows as CSV; numbers with six significant digits, lists spread over columns."""
    flat = [_spread(row) for row in rows]
    with new_file(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(flat[0]))
        writer.writeheader()
        writer.writerows(flat)


def _spread(row: Row) -> dict[str, str]:
    flat: dict[str, str] = {}
    for name, value in row.items():
        if isinstance(value, list | tuple):
            for end, one in zip(("low", "high"), value, strict=True):
                flat[f"{name}_{end}"] = f"{one:.6g}"
        else:
            flat[name] = f"{value:.6g}" if isinstance(value, float) else str(value)
    return flat


ALPHA_HEADER = (
    "alpha",
    "d_mm back [m]",
    "d_mp back [m]",
    "jerk back [m/s^3]",
    "steps back",
    "within 25",
    "within 50",
    "d_mm ahead [m]",
    "d_mp ahead [m]",
    "jerk ahead",
    "steps ahead",
    "return",
    "ZMP margin [m]",
)


def alpha_table(summaries: Sequence[Row], task: str, form: str) -> str:
    """One row per fixed alpha, as Markdown."""
    lines = []
    own = [
        row
        for row in summaries
        if (row["task"], row["form"], row["rule"]) == (task, form, "constant")
    ]
    for alpha in sorted({row["alpha"] for row in own}):
        back, ahead = (
            next(
                row
                for row in own
                if (row["alpha"], row["direction"]) == (alpha, direction)
            )
            for direction in ("backward", "forward")
        )
        goals = back["goals"] + ahead["goals"]
        total = back["goals"] * back["return"] + ahead["goals"] * ahead["return"]
        lines.append(
            (
                f"{alpha:g}",
                f"{back['d_mm']:.4f}",
                f"{back['d_mp']:.4f}",
                f"{back['base_jerk_rms']:.2f}",
                f"{back['steps']:.1f}",
                f"{100 * back['success_25']:.0f} %",
                f"{100 * back['success_50']:.0f} %",
                f"{ahead['d_mm']:.4f}",
                f"{ahead['d_mp']:.4f}",
                f"{ahead['base_jerk_rms']:.2f}",
                f"{ahead['steps']:.1f}",
                f"{total / goals:.2f}",
                f"{min(back['zmp_margin'], ahead['zmp_margin']):.3f}",
            )
        )
    return markdown_table(ALPHA_HEADER, lines)


def response_table(responses: Sequence[Response]) -> str:
    """How evenly each form answers to alpha, as Markdown."""
    header = (
        "task",
        "form",
        "largest share of one alpha step",
        "at alpha",
        "d_mm falls by [m]",
        "d_mp rises by [m]",
        "hump ahead [m]",
    )
    lines = [
        (
            one.task,
            one.form,
            f"{100 * one.largest_share:.0f} %",
            f"{one.at:g}",
            f"{max(one.d_mm_falls, 0):.4f}",
            f"{max(one.d_mp_rises, 0):.4f}",
            f"{max(one.hump, 0):.4f}",
        )
        for one in responses
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
        own = [row for row in worth if row["rule"] == rule]
        best = max(own, key=lambda row: float(row["return_fixed"]))
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
                f"{min(row['interval'][0] for row in own):.2f}",
            )
        )
    return markdown_table(header, lines)


def sweep_markdown(
    summaries: Sequence[Row], responses: Sequence[Response], worth: Sequence[Row]
) -> str:
    """Everything of an alpha sweep as one Markdown file."""
    parts = [
        "# What alpha does\n",
        "The PD agent at fixed alphas, half of the goals ahead and half behind. "
        "d_mm and d_mp: how far hand and base are from their targets at the end of a "
        "step. Steps to the goal, 50 where it was missed; the return is that of the "
        "registered task, which ends after 25.\n",
        "## How evenly the robot answers, going backward\n",
        response_table(responses),
    ]
    if worth:
        parts += [
            "## What a state-dependent alpha is worth on SmoothReach-v0\n",
            "On goals that were not used to choose the rules, paired by goal.\n",
            worth_table(worth),
        ]
    for task, form in sorted({(row["task"], row["form"]) for row in summaries}):
        parts += [f"## {task}, {form}\n", alpha_table(summaries, task, form)]
    return "\n".join(parts)
