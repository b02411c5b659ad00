"""Evaluations and sweeps as Markdown, as CSV or on the terminal."""

import csv
import gzip
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

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
    """Rows as CSV, compressed if the name ends in .gz.

    Numbers have six significant digits, intervals two columns.
    """
    flat = [_spread(row) for row in rows]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, fieldnames=list(flat[0]))
    writer.writeheader()
    writer.writerows(flat)
    data = text.getvalue().encode()
    if path.suffix == ".gz":
        data = gzip.compress(data, mtime=0)  # no clock in the bytes
    with new_file(path) as temporary:
        temporary.write_bytes(data)


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
    own = [
        row
        for row in summaries
        if (row["task"], row["form"], row["rule"]) == (task, form, "constant")
    ]
    lines = []
    for alpha in sorted({row["alpha"] for row in own}):
        pair = [
            next(row for row in own if (row["alpha"], row["direction"]) == (alpha, way))
            for way in ("backward", "forward")
        ]
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
        "registered task, which ends after 25. Pairs are backward, forward.\n",
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


ABUSE = {
    "joint_position_rad": ("joint position", "{:+.4f} rad"),
    "joint_velocity_share": ("joint velocity", "{:+.1%}"),
    "joint_torque_share": ("joint torque", "{:+.1%}"),
    "commanded_acceleration_share": ("acceleration, commanded", "{:+.2%}"),
    "measured_joint_acceleration_share": (
        "joint acceleration, over one tick of the simulator",
        "{:+.1%}",
    ),
    "measured_base_acceleration_share": (
        "base acceleration, over one tick of the simulator",
        "{:+.1%}",
    ),
    "base_speed_share": ("base speed", "{:+.1%}"),
    "base_yaw_rate_share": ("base yaw rate", "{:+.1%}"),
    "wheel_speed_share": ("wheel speed", "{:+.1%}"),
    "keep_out_m": ("keep-out plane", "{:+.4f} m"),
}
"""Limits watched by ``marl-mm bench abuse``: name and format of the worst excess."""


def abuse_table(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Worst excess over each limit per form, as Markdown; negative: never reached."""
    lines = [
        (name, *(form.format(one["worst_excess"][key]) for one in results.values()))
        for key, (name, form) in ABUSE.items()
    ]
    counts = (
        ("ticks", "ticks", "{}"),
        ("levels solved", "levels", "{}"),
        ("levels that failed", "failed_levels", "{}"),
        ("ticks that only braked", "safe_ticks", "{}"),
        ("least ZMP margin", "least_zmp_margin_m", "{:.3f} m"),
        ("largest tilt", "largest_tilt_rad", "{:.5f} rad"),
        ("largest wheel slip", "largest_wheel_slip_m_s", "{:.4f} m/s"),
        ("model's hand off the simulator's", "largest_model_ee_error_m", "{:.5f} m"),
        ("longest tick of the controller", "longest_controller_tick_us", "{:.0f} us"),
    )
    lines += [
        (name, *(form.format(one[key]) for one in results.values()))
        for name, key, form in counts
    ]
    return markdown_table(("worst excess over a limit", *results), lines)


def bench_table(result: Mapping[str, Any]) -> str:
    """Parts of a tick and other solvers on the same states, as Markdown."""
    names = {
        "tick": "whole tick",
        "simulation": "PyBullet's step",
        "io": "reading and commanding PyBullet",
        "controller": "controller: model and solving",
        "model": "model (Pinocchio)",
        "solve": "solving, Python included",
        "assembly": "assembly (compiled)",
        "levels": "levels without QPs (compiled)",
        "qp": "QPs (compiled)",
    }
    others = {
        "compiled": "compiled form, on the same states",
        "numpy_proxqp": "numpy and ProxQP",
        "numpy_daqp": "numpy and DAQP",
        "pink_weighted_qp": "Pink: one weighted QP, no torques",
    }
    step = result["us"]["simulation"]["median"]
    lines = []
    for table, part in ((names, result["us"]), (others, result["references_us"])):
        for key, name in table.items():
            if key in part:
                median, p99 = part[key]["median"], part[key]["p99"]
                ratio = f"{median / step:.2f}"
                lines.append((name, f"{median:.1f}", f"{p99:.0f}", ratio))
    return markdown_table(("part", "median [us]", "p99 [us]", "of a step"), lines)
