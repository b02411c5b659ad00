"""Learning curves of a study, as the paper draws them; the learnt alpha."""

import math
import re
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from marl_mm.eval.figures import COLORS, save_small
from marl_mm.eval.grouping import grouped
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.settings import Online
from marl_mm.eval.studies.shown import Curves
from marl_mm.eval.studies.study import Cell, Study, cell_name

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
    looks: dict[str, tuple[str, str]] = {}  # a name's, the same in all panels
    for axis, (title, cells) in zip(axes[0], panels.items(), strict=True):
        for number, cell in enumerate(cells):
            label = _label(cell, cells)
            turn, place = divmod(number, len(PAPER_COLORS))
            look = PAPER_COLORS[place], ("o-", "s--", "^:")[turn % 3]
            color, line = looks.setdefault(label, look)
            rows = store.curves(cell, seeds)
            clock = _CLOCKS[_clock(rows)]
            times, values = on_a_grid(rows, curves.value)
            if not len(values):  # each run diverged before its clock began
                continue
            mean = curves.scale * values.mean(axis=0)
            std = curves.scale * values.std(axis=0, ddof=min(1, len(values) - 1))
            _with_spread(axis, times, mean, std, color, label, line)
        axis.set(title=title, xlabel=clock, ylim=(curves.bottom, curves.top))
        if curves.panels != "dataset":
            axis.legend(frameon=False, fontsize=8)
    if curves.panels == "dataset":  # whose lines are the same in all
        axis.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1, 1))
    axes[0][0].set_ylabel(curves.label)
    save_small(figure, path)


def on_a_grid(rows: Sequence[Row], key: str) -> tuple[np.ndarray, np.ndarray]:
    """Every seed's curve at common times, of updates, episodes or own env steps.

    A run that ended before the others keeps its last value. Returns the times, shape
    (t,), and values, shape (seeds, t).
    """
    clock = _clock(rows)
    # The cell is empty where a run diverged before it began what the clock counts.
    rows = [r for r in rows if r[clock] != "" and not math.isnan(r[clock])]
    times = np.unique([row[clock] for row in rows])
    values = [
        np.interp(times, [row[clock] for row in curve], [row[key] for row in curve])
        for _, curve in sorted(grouped(rows, "seed").items())
    ]
    return times, np.array(values)


_CLOCKS = {
    "episode": "training episodes",
    "env_steps": "own env steps",
    "step": "updates",
}
"""Names of the columns that curves are drawn over."""


def _clock(rows: Sequence[Row]) -> str:
    return next(name for name in _CLOCKS if name in rows[0])


def _panel(cell: Cell, curves: Curves) -> str:
    source, setting = cell
    if curves.panels == "dataset":
        return cell_name(cell)[0].removeprefix("marl_mm/").removesuffix("-v0")
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
    of_settings, worths = grouped(steps, "setting"), grouped(worth, "setting")
    figure = Figure(figsize=(4.4 * len(of_settings), 6.0), layout="constrained")
    axes: Any = figure.subplots(2, len(of_settings), squeeze=False)
    for (setting, group), above, below in zip(of_settings.items(), *axes, strict=True):
        for direction, part in grouped(group, "direction").items():
            for number, line in enumerate(grouped(part, "seed").values()):
                time, mean, std = (
                    np.array([row[key] for row in line])
                    for key in ("step", "mean", "std")
                )
                color, label = COLORS[direction], None if number else direction
                _with_spread(above, time, mean, std, color, label)
        title = f"{labels[setting]}, {group[0]['task']}"
        above.set(title=title, xlabel="time [s]", ylim=(-0.05, 1.05))
        for number, line in enumerate(grouped(worths[setting], "seed").values()):
            held, learnt = (None, None) if number else ("held", "learnt")
            alphas = [row["alpha"] for row in line]
            returns = [row["return"] for row in line]
            below.plot(alphas, returns, "o-", ms=3, color="#333333", label=held)
            below.axhline(line[0]["learnt_return"], color="#2e7d4f", label=learnt)
        below.set(xlabel="alpha, held", ylabel="return")
    axes[0][0].set_ylabel("learnt alpha (1 = stable base)")
    axes[0][0].legend(frameon=False)
    axes[1][0].legend(frameon=False)
    save_small(figure, path)


def engines_figure(summary: Sequence[Row], path: Path) -> None:
    """Success on one engine against the other, a panel per task, a point per policy.

    Args:
        summary: Rows of ``engines_summary.paired``.
        path: File of the PNG.
    """
    tasks = grouped(summary, "task")
    looks = dict(zip(_kinds(summary), product("o^sv", PAPER_COLORS), strict=False))
    columns = min(3, len(tasks))
    lines = -(-len(tasks) // columns)
    figure = Figure(figsize=(3.2 * columns, 3.7 * lines), layout="constrained")
    axes: Any = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
    for axis in axes.flat[len(tasks) :]:
        axis.remove()
    for axis, (task, rows) in zip(axes.flat, tasks.items(), strict=False):
        axis.plot((0, 100), (0, 100), color="#8a8a8a", lw=1)
        for kind, group in _kinds(rows).items():
            shape, color = looks[kind]
            first, other = (
                [100 * row[key] for row in group]
                for key in ("success", "success_beside")
            )
            axis.plot(first, other, shape, ms=4, color=color, label=kind)
        axis.set(title=task, box_aspect=1)
        axis.legend(frameon=False, fontsize=8)
    figure.supxlabel(f"goals reached on {summary[0]['engine']} [%]", fontsize=10)
    figure.supylabel(f"goals reached on {summary[0]['beside']} [%]", fontsize=10)
    save_small(figure, path)


def _kinds(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by the beginning of the policies' names, such as pd, medium or td3-bc."""
    kinds: dict[str, list[Row]] = {}
    for row in rows:
        kind = re.split(r"-(?=kp|noise|room|good|scripted|\d)", row["policy"])[0]
        kinds.setdefault(kind, []).append(row)
    return kinds


def _with_spread(
    axis: Any,
    times: np.ndarray,
    mean: np.ndarray,
    std: np.ndarray,
    color: str,
    label: str | None,
    line: str = "o-",
) -> None:
    """Draw a mean over time in a band of one deviation to each side."""
    axis.plot(times, mean, line, ms=2, color=color, label=label)
    low, high = mean - std, mean + std
    axis.fill_between(times, low, high, color=color, alpha=0.2, linewidth=0)
