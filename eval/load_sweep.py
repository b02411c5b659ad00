"""What alpha does with a load: the PD agent on ``CarryReach-v0``, by mass and alpha."""

from collections.abc import Sequence
from contextlib import closing

import numpy as np
from numpy.typing import NDArray

from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.drive import Drive, Tick
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import run_episode
from marl_mm.eval.goals import goal_set
from marl_mm.eval.intervals import bootstrap_interval
from marl_mm.eval.metrics import Row
from marl_mm.eval.sweep import SweepCell, episode_rows
from marl_mm.robot.description import CASTER_X

CARRY = "CarryReach-v0"

MASSES = (0.1, 1.0, 2.0, 3.0)
"""[kg]"""

ALPHAS = (0.0, 0.25, 0.5, 0.75, 1.0)

GAINED = ("zmp_margin", "zmp_fore_aft")
"""Of which alpha's gain is looked at."""


def load_cells(goals: int, seed: int) -> list[SweepCell]:
    """Every mass at every alpha, on the same goals.

    Args:
        goals: Half ahead, half behind.
        seed: Of the goals.
    """
    return [
        SweepCell(CARRY, "blend", PdConfig(alpha=alpha), goals, seed, mass=mass)
        for mass in MASSES
        for alpha in ALPHAS
    ]


class _Swing:
    """Where along the base its zero-moment point has been, every few ticks."""

    def __init__(self, drive: Drive, every: int) -> None:
        self._drive, self._every = drive, every
        self._x: list[float] = []

    def see(self, tick: Tick) -> None:
        if tick.number % self._every == 0:
            self._x.append(self._drive.zmp_b(tick.state, tick.command)[0])

    def to_row(self) -> Row:
        front, rear = CASTER_X
        least, most = min(self._x), max(self._x)
        return {
            "zmp_fore_aft": min(front - most, least - rear),
            "zmp_span": most - least,
        }


def run_load_cell(cell: SweepCell) -> list[Row]:
    """One row per goal, with what the zero-moment point did along the base.

    ``zmp_fore_aft`` is its least distance to the support's front or rear edge,
    ``zmp_span`` how far it went from end to end [m]: the margin to all edges is nearly
    always that to the sides, which the base's way ahead does not change.
    """
    config = make_task(cell.task, cell.overrides)
    policy, rows = PdPolicy(cell.pd), []
    with closing(EpisodeCore(config)) as core:
        for plan in goal_set(config, cell.goals, cell.seed):
            swing = _Swing(core.drive, config.look_every)
            episode = run_episode(core, policy, plan, swing.see)
            rows += [{**row, **swing.to_row()} for row in episode_rows(cell, episode)]
    return rows


def summarize_loads(rows: Sequence[Row]) -> list[Row]:
    """One row per mass and alpha, with gains over alpha 0.

    Gains are paired by goal, and so is how much larger they are than with the least
    mass.
    """
    masses = sorted({row["mass"] for row in rows})
    alphas = sorted({row["alpha"] for row in rows})
    own = {
        (mass, alpha): sorted(
            (row for row in rows if (row["mass"], row["alpha"]) == (mass, alpha)),
            key=lambda row: row["goal"],
        )
        for mass in masses
        for alpha in alphas
    }
    means = ("success", "steps", "d_mm", "base_jerk_rms", "zmp_span", *GAINED)
    summary = []
    for (mass, alpha), of_cell in own.items():
        row: Row = {"mass": mass, "alpha": alpha, "goals": len(of_cell)}
        row |= {name: float(_column(of_cell, name).mean()) for name in means}
        for name in GAINED:
            gain, light = (
                _column(own[which, alpha], name) - _column(own[which, alphas[0]], name)
                for which in (mass, masses[0])
            )
            row[f"{name}_least"] = float(_column(of_cell, name).min())
            row[f"{name}_gain"] = float(gain.mean())
            row[f"{name}_gain_interval"] = bootstrap_interval(gain)
            row[f"{name}_more"] = float((gain - light).mean())
            row[f"{name}_more_interval"] = bootstrap_interval(gain - light)
        summary.append(row)
    return summary


def _column(rows: Sequence[Row], name: str) -> NDArray[np.float64]:
    return np.array([float(row[name]) for row in rows])
