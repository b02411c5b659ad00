"""A dataset's card as one figure."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import ALPHA, EE

_REACHED, _MISSED = "#1b6ca8", "#c8553d"


def draw_card(arrays: EpisodeArrays, values: dict[str, Any], path: Path) -> None:
    """Goals, hands, lengths, returns, displacements and alphas, as PNG.

    Args:
        arrays: The dataset's episodes.
        values: Its card.
        path: To write.
    """
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    _goals(axes[0], arrays)
    _hands(axes[1], arrays)
    axes[2].hist(arrays.lengths, bins=np.arange(arrays.lengths.max() + 2) - 0.5)
    axes[2].set(xlabel="steps of an episode", ylabel="episodes")
    for axis in (axes[2].xaxis, axes[2].yaxis, axes[3].yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))
    reached = arrays.successes()
    returns = arrays.returns()
    axes[3].hist(
        [returns[reached], returns[~reached]],
        bins=30,
        stacked=True,
        color=(_REACHED, _MISSED),
        label=("goal reached", "missed"),
    )
    axes[3].set(xlabel="return", ylabel="episodes")
    axes[3].legend(frameon=False)
    for column, name in enumerate(arrays.layout.action[:ALPHA]):
        axes[4].hist(
            arrays.actions[:, column], 40, range=(-1, 1), histtype="step", label=name
        )
    axes[4].set(xlabel="displacement (1: 10 cm)", ylabel="steps", yscale="log")
    axes[4].legend(frameon=False, loc="upper center")
    axes[5].hist(arrays.actions[:, ALPHA], 40, range=(0, 1))
    axes[5].set(xlabel="alpha: 0 accurate hand ... 1 stable base", ylabel="steps")
    figure.suptitle(
        f"{values['id']}: {values['steps']} steps, {values['episodes']} episodes"
    )
    figure.savefig(path, dpi=110, format="png")


def _goals(axes: Axes, arrays: EpisodeArrays) -> None:
    goals, reached = arrays.first_states()[:, arrays.layout.goal], arrays.successes()
    size = float(np.clip(200 / np.sqrt(len(goals)), 2, 8))  # [pt]: all can be seen
    for chosen, color, label in (
        (reached, _REACHED, "goal reached"),
        (~reached, _MISSED, "missed"),
    ):
        axes.plot(*goals[chosen, :2].T, ".", ms=size, color=color, label=label)
    axes.set(xlabel="goal x [m]", ylabel="goal y [m]")
    axes.legend(frameon=False, markerscale=8 / size)


def _hands(axes: Axes, arrays: EpisodeArrays) -> None:
    hands = arrays.states[:, EE]
    x, z = hands[:, 0], hands[:, 2]
    cells = axes.hexbin(x, z, gridsize=40, bins="log", cmap="Blues", mincnt=1)
    axes.figure.colorbar(cells, ax=axes, label="states")
    axes.set(xlabel="hand x [m]", ylabel="hand z [m]")
