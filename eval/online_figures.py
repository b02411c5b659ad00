"""Figures of online learning: the paper's Figs 4 and 5; the learnt alpha."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from marl_mm.eval.figures import COLORS, save_small
from marl_mm.eval.metrics import Row
from marl_mm.eval.online import on_a_grid

PAPER_COLORS = ("#c8553d", "#2e7d4f", "#1b6ca8", "#8a6fb0", "#8a8a8a", "#c9a227")
"""Red without, green with hindsight, as in the paper; then others."""


def seed_curves(
    curves: Sequence[Row],
    panels: Mapping[str, Mapping[str, str]],
    key: str,
    ylabel: str,
    path: Path,
    scale: float = 1.0,
    bottom: float | None = None,
    top: float | None = None,
) -> None:
    """Mean and standard deviation over seeds, a line per setting, side by side.

    Args:
        curves: Rows of ``curve_rows``.
        panels: By title, settings to draw and what to call them.
        key: Column to draw.
        ylabel: Its name and unit.
        path: PNG file.
        scale: Factor of the values.
        bottom: Where the figure cuts off; None shows everything.
        top: Likewise.
    """
    figure = Figure(figsize=(1.2 + 5.2 * len(panels), 4.0), layout="constrained")
    axes: Any = figure.subplots(1, len(panels), sharey=True, squeeze=False)
    known: dict[str, str] = {}  # what has a name has one color in all panels
    for axis, (title, labels) in zip(axes[0], panels.items(), strict=True):
        for (setting, label), color in zip(labels.items(), PAPER_COLORS, strict=False):
            color = known.setdefault(label, color)
            times, values = on_a_grid(curves, setting, key)
            mean = scale * values.mean(axis=0)
            std = scale * values.std(axis=0, ddof=min(1, len(values) - 1))
            seeds = f"{label} ({len(values)} seed{'s' * (len(values) > 1)})"
            axis.plot(times, mean, "o-", ms=2, color=color, label=seeds)
            axis.fill_between(
                times, mean - std, mean + std, color=color, alpha=0.2, linewidth=0
            )
        axis.set(title=title, xlabel="training episodes")
        if bottom is not None or top is not None:
            axis.set_ylim(bottom, top)
        axis.legend(frameon=False)
    axes[0][0].set_ylabel(ylabel)
    save_small(figure, path)


def alpha_figure(
    steps: Sequence[Row], worth: Sequence[Row], labels: Mapping[str, str], path: Path
) -> None:
    """Above: alpha over time by direction. Below: the return with alpha held.

    A column per setting, a line per seed.
    """
    settings = list(dict.fromkeys(row["setting"] for row in steps))
    figure = Figure(figsize=(4.4 * len(settings), 6.0), layout="constrained")
    axes: Any = figure.subplots(2, len(settings), squeeze=False)
    for column, setting in enumerate(settings):
        above, below = axes[0][column], axes[1][column]
        mine = [row for row in steps if row["setting"] == setting]
        for direction in ("forward", "backward"):
            own = [row for row in mine if row["direction"] == direction]
            for number, seed in enumerate(sorted({row["seed"] for row in own})):
                line = [row for row in own if row["seed"] == seed]
                time = np.array([row["step"] for row in line])
                mean = np.array([row["mean"] for row in line])
                std = np.array([row["std"] for row in line])
                color, label = COLORS[direction], None if number else direction
                above.plot(time, mean, "o-", ms=3, color=color, label=label)
                above.fill_between(
                    time, mean - std, mean + std, color=color, alpha=0.15, linewidth=0
                )
        title = f"{labels[setting]}, {mine[0]['task']}"
        above.set(title=title, xlabel="time [s]", ylim=(-0.05, 1.05))
        own = [row for row in worth if row["setting"] == setting]
        for number, seed in enumerate(sorted({row["seed"] for row in own})):
            line = [row for row in own if row["seed"] == seed]
            names = (None, None) if number else ("held", "learnt")
            alphas = [row["alpha"] for row in line]
            returns = [row["return"] for row in line]
            below.plot(alphas, returns, "o-", ms=3, color="#333333", label=names[0])
            learnt = line[0]["learnt_return"]
            below.axhline(learnt, color="#2e7d4f", label=names[1])
        below.set(xlabel="alpha, held", ylabel="return")
    axes[0][0].set_ylabel("learnt alpha (1 = stable base)")
    axes[0][0].legend(frameon=False)
    axes[1][0].legend(frameon=False)
    save_small(figure, path)
