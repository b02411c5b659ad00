"""Learning curves of a study, as the paper draws them; the learnt alpha."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from marl_mm.eval.figures import COLORS, save_small
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.study import Cell, Curves, Online, Study, cell_name

PAPER_COLORS = ("#c8553d", "#2e7d4f", "#1b6ca8", "#8a6fb0", "#8a8a8a", "#c9a227")
"""Colors of lines: red without, green with hindsight, as in the paper; then others."""


def curves_figure(
    study: Study, curves: Curves, store: RowStore, seeds: Sequence[int], path: Path
) -> None:
    """Draw learning curves into a PNG: mean and deviation over seeds, a line a cell."""
    panels: dict[str, list[Cell]] = {}
    for cell in study.cells:
        panels.setdefault(_panel(cell, curves), []).append(cell)
    figure = Figure(figsize=(1.2 + 4.6 * len(panels), 3.9), layout="constrained")
    axes: Any = figure.subplots(1, len(panels), sharey=True, squeeze=False)
    known: dict[str, str] = {}  # what has a name has one color in all panels
    for axis, (title, cells) in zip(axes[0], panels.items(), strict=True):
        clock = "updates"
        for number, cell in enumerate(cells):
            label = _label(cell, cells)
            color = known.setdefault(label, PAPER_COLORS[number % len(PAPER_COLORS)])
            rows = store.curves(cell, seeds)
            clock = "training episodes" if "episode" in rows[0] else clock
            times, values = on_a_grid(rows, curves.value)
            mean = curves.scale * values.mean(axis=0)
            std = curves.scale * values.std(axis=0, ddof=min(1, len(values) - 1))
            axis.plot(times, mean, "o-", ms=2, color=color, label=label)
            low, high = mean - std, mean + std
            axis.fill_between(times, low, high, color=color, alpha=0.2, linewidth=0)
        axis.set(title=title, xlabel=clock, ylim=(curves.bottom, curves.top))
        axis.legend(frameon=False, fontsize=8)
    axes[0][0].set_ylabel(curves.label)
    save_small(figure, path)


def on_a_grid(rows: Sequence[Row], key: str) -> tuple[np.ndarray, np.ndarray]:
    """Every seed's curve at common times, of updates or episodes.

    A run that ended before the others keeps its last value. Returns the times, shape
    (t,), and values, shape (seeds, t).
    """
    clock = "episode" if "episode" in rows[0] else "step"
    times = np.unique([row[clock] for row in rows])
    values = []
    for seed in sorted({row["seed"] for row in rows}):
        own = [row for row in rows if row["seed"] == seed]
        known = [row[clock] for row in own], [row[key] for row in own]
        values.append(np.interp(times, *known))
    return times, np.stack(values)


def _panel(cell: Cell, curves: Curves) -> str:
    source, setting = cell
    if curves.panels == "task" and isinstance(source, Online):
        return source.task
    return f"{setting.preset} preset"


def _label(cell: Cell, panel: Sequence[Cell]) -> str:
    """Label of a line in its panel: the source, the setting, or both."""
    source, _ = cell_name(cell)
    if len(panel) > 1 and len({way.name for _, way in panel}) == 1:
        return source
    if isinstance(cell[0], Online) or len({cell_name(line)[0] for line in panel}) == 1:
        return cell[1].about
    return f"{source}, {cell[1].about}"


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
                time, mean, std = (
                    np.array([row[key] for row in line])
                    for key in ("step", "mean", "std")
                )
                color, label = COLORS[direction], None if number else direction
                above.plot(time, mean, "o-", ms=3, color=color, label=label)
                low, high = mean - std, mean + std
                above.fill_between(
                    time, low, high, color=color, alpha=0.15, linewidth=0
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
