"""Learning curves of an ablation, as the paper draws them: Figs 7 to 10."""

from collections.abc import Callable, Sequence
from itertools import cycle, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from marl_mm.eval.ablation import Ablation, Cell
from marl_mm.eval.figures import save_small
from marl_mm.eval.metrics import Row
from marl_mm.eval.online_figures import PAPER_COLORS


def curves_figure(
    ablation: Ablation, read: Callable[[Cell], Sequence[Row]], path: Path
) -> None:
    """Success over updates: mean and standard deviation over seeds.

    A panel per preset, a line per cell.

    Args:
        ablation: Whose cells are drawn.
        read: Gives a cell's rows: ``seed``, ``step``, ``success_all``.
        path: PNG file.
    """
    presets = list(dict.fromkeys(setting.preset for _, setting in ablation.cells))
    figure = Figure(figsize=(1.2 + 4.2 * len(presets), 3.8), layout="constrained")
    axes: Any = figure.subplots(1, len(presets), sharey=True, squeeze=False)
    for axis, preset in zip(axes[0], presets, strict=True):
        own = [cell for cell in ablation.cells if cell[1].preset == preset]
        for cell, color in zip(own, cycle(PAPER_COLORS)):
            _draw(axis, read(cell), _label(cell, own), color)
        axis.set(title=f"{preset} preset", xlabel="updates [thousands]", ylim=(-3, 103))
        axis.legend(frameon=False, fontsize=8)
    axes[0][0].set_ylabel("goals reached [%]")
    save_small(figure, path)


def _draw(axis: Any, rows: Sequence[Row], label: str, color: str) -> None:
    steps = sorted({row["step"] for row in rows})
    seeds = sorted({row["seed"] for row in rows})
    found = {(row["seed"], row["step"]): row["success_all"] for row in rows}
    for seed in seeds:
        for before, step in pairwise(steps):  # one that diverged counts as it was
            found.setdefault((seed, step), found[seed, before])
    rates = 100 * np.array([[found[seed, step] for step in steps] for seed in seeds])
    mean, std = rates.mean(axis=0), rates.std(axis=0, ddof=min(1, len(seeds) - 1))
    time = np.array(steps) / 1000
    axis.plot(time, mean, "o-", ms=2, color=color, label=label)
    low, high = (mean - std).clip(0, 100), (mean + std).clip(0, 100)
    axis.fill_between(time, low, high, color=color, alpha=0.2, linewidth=0)


def _label(cell: Cell, panel: Sequence[Cell]) -> str:
    """What sets a line apart in its panel: the dataset, the setting, or both."""
    dataset, setting = cell
    if len({one.name for _, one in panel}) == 1:
        return dataset
    if len({name for name, _ in panel}) == 1:
        return setting.about
    return f"{dataset}, {setting.about}"
