"""The figure of a dataset's card."""

from pathlib import Path
from typing import IO, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from marl_mm.datasets.arrays import EpisodeArrays

_BARS = 100
"""Largest number of bars of a histogram of lengths; up to it each length has one."""

_HAND = ("end_effector_x", "end_effector_z")

_MARGINS = {
    **{"left": 0.06, "right": 0.98, "bottom": 0.08, "top": 0.93},
    **{"wspace": 0.27, "hspace": 0.25},
}
"""Margins of the axes; a layout that is computed takes as long as the drawing."""

_REACHED, _MISSED = "#1b6ca8", "#c8553d"


def draw_card(
    arrays: EpisodeArrays, values: dict[str, Any], file: Path | IO[bytes]
) -> None:
    """Draw goals, hands, lengths, returns, displacements and alphas, as a PNG.

    Args:
        arrays: The dataset's episodes.
        values: The dataset's card.
        file: Path or open file to write.
    """
    figure = Figure(figsize=(12, 6.4))
    axes = figure.subplots(2, 3, gridspec_kw=_MARGINS).ravel()
    _goals(axes[0], arrays)
    _hands(axes[1], arrays)
    longest = int(arrays.lengths.max())
    edges = np.arange(0, longest + 2 + longest // _BARS, 1 + longest // _BARS)
    axes[2].hist(arrays.lengths, bins=edges - 0.5)
    axes[2].set(xlabel="steps of an episode", ylabel="episodes")
    for axis in (axes[2].xaxis, axes[2].yaxis, axes[3].yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))
    reached = arrays.successes()
    returns = arrays.returns()
    low, high = returns.min(), returns.max()
    if np.isclose(low, high):  # but for last bits
        low, high = low - 0.5, high + 0.5
    axes[3].hist(
        [returns[reached], returns[~reached]],
        bins=30,
        range=(low, high),
        stacked=True,
        color=(_REACHED, _MISSED),
        label=("goal reached", "missed"),
    )
    axes[3].set(xlabel="return", ylabel="episodes")
    axes[3].legend(frameon=False)
    _actions(axes[4], axes[5], arrays)
    figure.suptitle(
        f"{values['id']}: {values['steps']} steps, {values['episodes']} episodes",
        parse_math=False,  # an id may hold dollars
    )
    figure.savefig(file, dpi=110, format="png")


def _actions(others: Axes, alphas: Axes, arrays: EpisodeArrays) -> None:
    """Draw histograms of the actions; alpha has its own axes."""
    layout = arrays.layout
    span = min(layout.low), max(layout.high)
    for column, name in enumerate(layout.action_names):
        values = arrays.actions[:, column]
        if name == "alpha":
            alphas.hist(values, 40, range=(0, 1))
            label = "alpha: 0 accurate hand ... 1 stable base"
            alphas.set(xlabel=label, ylabel="steps")
        else:
            others.hist(values, 40, range=span, histtype="step", label=name)
    if "alpha" not in layout.action_names:
        alphas.set_axis_off()
    moves = any(name.startswith("delta_") for name in layout.action_names)
    label = "displacement (1: 10 cm)" if moves else "action"
    others.set(xlabel=label, ylabel="steps", yscale="log")
    if others.has_data():
        others.legend(frameon=False, loc="upper center")


def _goals(axes: Axes, arrays: EpisodeArrays) -> None:
    goals, reached = arrays.first_states()[:, arrays.layout.goal], arrays.successes()
    plane = [0, min(1, goals.shape[1] - 1)]
    size = float(np.clip(200 / np.sqrt(len(goals)), 2, 8))  # [pt]: all stay visible
    for chosen, color, label in (
        (reached, _REACHED, "goal reached"),
        (~reached, _MISSED, "missed"),
    ):
        axes.plot(*goals[chosen][:, plane].T, ".", ms=size, color=color, label=label)
    state = {entry.name: entry for entry in arrays.layout.state}
    entries = [state[name] for name in arrays.layout.desired[:2]]
    names = [f"{entry.name.replace('_', ' ')} [{entry.unit}]" for entry in entries]
    axes.set_xlabel(names[0], parse_math=False)  # a unit may hold dollars
    axes.set_ylabel(names[-1], parse_math=False)
    axes.legend(frameon=False, markerscale=8 / size)


def _hands(axes: Axes, arrays: EpisodeArrays) -> None:
    if not set(_HAND) <= set(arrays.layout.state_names):
        axes.set_axis_off()
        return
    x, z = arrays.states[:, arrays.layout.columns(*_HAND)].T
    cells = axes.hexbin(x, z, gridsize=40, bins="log", cmap="Blues", mincnt=1)
    axes.figure.colorbar(cells, ax=axes, label="states")
    axes.set(xlabel="hand x [m]", ylabel="hand z [m]")
