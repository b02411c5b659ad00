"""Figures of runs and episodes, as PNG."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from PIL import Image

from marl_mm.episode import Episode
from marl_mm.eval.metrics import Row, alphas
from marl_mm.files import new_file

COLORS = {"forward": "#1b6ca8", "backward": "#c8553d", "all": "#333333"}

_MARGINS = {"left": 0.08, "right": 0.99, "bottom": 0.15, "top": 0.96, "wspace": 0.3}
"""Margins of a row of axes; a layout that is computed takes as long as the drawing."""


def learning_curve(metrics: Sequence[dict[str, Any]], path: Path) -> None:
    """Success, imitation and, with critics, Q over updates of an offline run.

    A dotted line is where it goes on online.
    """
    critics = any("q/data" in row for row in metrics)
    figure = Figure(figsize=(9 + 3 * critics, 3.2))
    success, imitation, *value = figure.subplots(1, 2 + critics, gridspec_kw=_MARGINS)
    _over_directions(success, metrics, "step", "success", 100)
    success.set(ylabel="goals reached [%]", ylim=(-3, 103))
    for key in dict.fromkeys(key for row in metrics for key in row):
        if key.startswith("imitation/"):
            _plot(imitation, metrics, "step", key, key.removeprefix("imitation/"))
    imitation.set(ylabel="mean square difference to the data", yscale="log")
    for axis in value:
        _plot(axis, metrics, "step", "q/policy", "of the policy")
        _plot(axis, metrics, "step", "q/data", "of the data")
        axis.set(ylabel="Q")
    switches = [row["step"] for row in metrics if row.get("env_steps") == 0]
    for axis in (success, imitation, *value):
        axis.set_xlabel("updates")
        if axis.lines:
            axis.legend(frameon=False)
        for step in switches:
            axis.axvline(step, color="grey", linestyle=":")
    save(figure, path)


def online_curve(metrics: Sequence[dict[str, Any]], path: Path) -> None:
    """Success rate, return, Q and alpha over episodes, from an online run's metrics."""
    figure = Figure(figsize=(12, 3.2))
    success, returns, value, alpha = figure.subplots(1, 4, gridspec_kw=_MARGINS)
    _over_directions(success, metrics, "episode", "success", 100)
    success.set(ylabel="goals reached [%]", ylim=(-3, 103))
    _over_directions(returns, metrics, "episode", "return")
    returns.set(ylabel="return")
    _plot(value, metrics, "episode", "q/policy", "of the policy")
    _plot(value, metrics, "episode", "q/data", "of the data")
    value.set(ylabel="Q")
    value.legend(frameon=False)
    _over_directions(alpha, metrics, "episode", "alpha")
    alpha.set(ylabel="alpha (1 = stable base)", ylim=(-0.03, 1.03))
    for axis in (success, returns, value, alpha):
        axis.set_xlabel("episodes")
    success.legend(frameon=False)
    save(figure, path)


def _plot(
    axis: Any, metrics: Sequence[dict[str, Any]], clock: str, key: str, label: str
) -> None:
    """The known values of a key, over the clock."""
    rows = [row for row in metrics if key in row]
    axis.plot([row[clock] for row in rows], [row[key] for row in rows], label=label)


def _over_directions(
    axis: Any,
    metrics: Sequence[dict[str, Any]],
    clock: str,
    name: str,
    scale: float = 1.0,
) -> None:
    """Evaluations on a learning curve, a line per direction."""
    for direction in ("all", "forward", "backward"):
        rows = [row for row in metrics if f"{name}/{direction}" in row]
        if not rows:
            continue
        values = [scale * row[f"{name}/{direction}"] for row in rows]
        times = [row[clock] for row in rows]
        axis.plot(times, values, "o-", ms=3, label=direction, color=COLORS[direction])


def alpha_over_time(episodes: dict[str, Sequence[Episode]], path: Path) -> None:
    """Alpha and distance to the goal over time, one column per policy."""
    figure = Figure(figsize=(4.2 * len(episodes), 4.6), layout="constrained")
    axes = figure.subplots(2, len(episodes), sharex=True, sharey="row", squeeze=False)
    for column, (name, runs) in enumerate(episodes.items()):
        above, below = axes[0][column], axes[1][column]
        for episode in runs:
            label = episode.direction or "all"
            color = COLORS[label]
            time = range(1, len(episode) + 1)
            above.plot(time, alphas(episode), "o-", ms=3, color=color, label=label)
            distance = episode.info["distance"]
            below.plot(time, distance, "o-", ms=3, color=color, label=label)
        above.set(title=name, ylim=(-0.05, 1.05))
        below.set(xlabel="time [s]")
    axes[0][0].set(ylabel="alpha (1 = stable base)")
    axes[1][0].set(ylabel="distance to goal [m]")
    axes[0][0].legend(frameon=False)
    save(figure, path)


FORM_COLORS = {"blend": "#1b6ca8", "rhp": "#c8553d", "rhp-literal": "#8a8a8a"}


def alpha_response(summaries: Sequence[Row], path: Path) -> None:
    """Errors, jerk and steps over alpha, one line per form, on the first task."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    axes: Any = figure.subplots(2, 4, sharex=True)
    columns = (
        ("d_mm", "hand behind its target, d_mm [m]"),
        ("d_mp", "base behind its plan, d_mp [m]"),
        ("base_jerk_rms", "base jerk [m/s^3]"),
        ("steps", "steps to the goal"),
    )
    task = _first_task(summaries)
    for line, direction in zip(axes, ("backward", "forward"), strict=True):
        for axis, (name, label) in zip(line, columns, strict=True):
            for form in _forms(summaries):
                rows = _over_alpha(summaries, task, form, direction)
                axis.plot(
                    [row["alpha"] for row in rows],
                    [row[name] for row in rows],
                    "o-",
                    ms=3,
                    color=FORM_COLORS[form],
                    label=form,
                )
            axis.set_ylim(bottom=0)
            axis.set_title(f"{label}\n{direction}", fontsize=8)
            axis.tick_params(labelsize=7)
    for axis in axes[1]:
        axis.set_xlabel("alpha", fontsize=8)
    axes[0][0].legend(frameon=False, fontsize=7)
    save_small(figure, path)


def alpha_pareto(summaries: Sequence[Row], path: Path) -> None:
    """Hand error against base error going backward, a curve per form over alpha."""
    tasks = sorted({row["task"] for row in summaries}, reverse=True)
    figure = Figure(figsize=(4.2 * len(tasks), 3.6), layout="constrained")
    axes: Any = figure.subplots(1, len(tasks), squeeze=False)
    for axis, task in zip(axes[0], tasks, strict=True):
        for form in _forms(summaries):
            rows = _over_alpha(summaries, task, form, "backward")
            hand = [100 * row["d_mm"] for row in rows]
            base = [100 * row["d_mp"] for row in rows]
            axis.plot(base, hand, "o-", ms=3, color=FORM_COLORS[form], label=form)
            if form == "blend":
                for row, x, y in zip(rows, base, hand, strict=True):
                    axis.annotate(
                        f"{row['alpha']:g}",
                        (x, y),
                        xytext=(4, 3),
                        textcoords="offset points",
                        fontsize=7,
                    )
        axis.set(
            title=f"{task}, backward",
            xlabel="base behind its plan, d_mp [cm]",
            ylabel="hand behind its target, d_mm [cm]",
        )
    axes[0][0].legend(frameon=False)
    save_small(figure, path)


def load_response(summaries: Sequence[Row], path: Path) -> None:
    """ZMP margins and the base's jerk over alpha, a line per mass of the load."""
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    axes: Any = figure.subplots(1, 3)
    columns = (
        ("zmp_margin", "ZMP to any edge [m]"),
        ("zmp_fore_aft", "ZMP to the front or rear edge [m]"),
        ("base_jerk_rms", "base jerk [m/s^3]"),
    )
    masses = sorted({row["mass"] for row in summaries})
    for axis, (name, label) in zip(axes, columns, strict=True):
        for number, mass in enumerate(masses):
            rows = [row for row in summaries if row["mass"] == mass]
            axis.plot(
                [row["alpha"] for row in rows],
                [row[name] for row in rows],
                "o-",
                ms=3,
                color=matplotlib.colormaps["viridis"](0.9 * number / len(masses)),
                label=f"{mass:g} kg",
            )
        axis.set_title(label, fontsize=9)
        axis.set_xlabel("alpha")
    axes[-1].legend(frameon=False, fontsize=8)
    save_small(figure, path)


def _first_task(summaries: Sequence[Row]) -> str:
    tasks = {row["task"] for row in summaries}
    return "Reach-v0" if "Reach-v0" in tasks else min(tasks)


def _forms(summaries: Sequence[Row]) -> list[str]:
    return [form for form in FORM_COLORS if any(r["form"] == form for r in summaries)]


def _over_alpha(
    summaries: Sequence[Row], task: str, form: str, direction: str
) -> list[Row]:
    wanted = (task, form, "constant", direction)
    rows = [
        row
        for row in summaries
        if (row["task"], row["form"], row["rule"], row["direction"]) == wanted
    ]
    return sorted(rows, key=lambda row: float(row["alpha"]))


def save_small(figure: Figure, path: Path) -> None:
    """Write a figure as PNG of few colors, which is a third as large.

    An octree keeps the few pixels of a rare color, which a median cut mixes with
    others.
    """
    drawn = BytesIO()
    figure.savefig(drawn, dpi=130)
    with new_file(path) as temporary, Image.open(drawn) as picture:
        octree, dither = Image.Quantize.FASTOCTREE, Image.Dither.NONE
        few = picture.convert("RGB").quantize(256, octree, dither=dither)
        few.save(temporary, "png", optimize=True)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG; it appears whole or not at all."""
    with new_file(path) as temporary:
        figure.savefig(temporary, dpi=130)
