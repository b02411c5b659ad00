"""Figures of runs and episodes, as PNG."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from marl_mm.episode import Episode
from marl_mm.files import new_file
from marl_mm.layout import ALPHA

COLORS = {"forward": "#1b6ca8", "backward": "#c8553d", "all": "#333333"}


def learning_curve(metrics: Sequence[dict[str, Any]], path: Path) -> None:
    """Loss per agent and success rate over updates, from a run's metrics."""
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    loss, success = figure.subplots(1, 2)
    for key in sorted({k for row in metrics for k in row if k.startswith("loss/")}):
        rows = [row for row in metrics if key in row]
        steps = [row["step"] for row in rows]
        loss.semilogy(steps, [row[key] for row in rows], label=key.split("/")[1])
    loss.set(xlabel="updates", ylabel="behaviour cloning loss")
    loss.legend(frameon=False)
    for direction in ("all", "forward", "backward"):
        key = f"success/{direction}"
        rows = [row for row in metrics if key in row]
        steps = [row["step"] for row in rows]
        rates = [100 * row[key] for row in rows]
        success.plot(steps, rates, "o-", ms=3, label=direction, color=COLORS[direction])
    success.set(xlabel="updates", ylabel="goals reached [%]", ylim=(-3, 103))
    success.legend(frameon=False)
    _save(figure, path)


def alpha_over_time(episodes: dict[str, Sequence[Episode]], path: Path) -> None:
    """Alpha and distance to the goal over time, one column per policy."""
    figure = Figure(figsize=(4.2 * len(episodes), 4.6), layout="constrained")
    axes = figure.subplots(2, len(episodes), sharex=True, sharey="row", squeeze=False)
    for column, (name, runs) in enumerate(episodes.items()):
        above, below = axes[0][column], axes[1][column]
        for episode in runs:
            color, label = COLORS[episode.direction], episode.direction
            time = range(1, len(episode) + 1)
            above.plot(
                time, episode.actions[:, ALPHA], "o-", ms=3, color=color, label=label
            )
            distance = episode.info["distance"]
            below.plot(time, distance, "o-", ms=3, color=color, label=label)
        above.set(title=name, ylim=(-0.05, 1.05))
        below.set(xlabel="time [s]")
    axes[0][0].set(ylabel="alpha (1 = stable base)")
    axes[1][0].set(ylabel="distance to goal [m]")
    axes[0][0].legend(frameon=False)
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    with new_file(path) as temporary:
        figure.savefig(temporary, dpi=130)
