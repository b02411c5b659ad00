"""What alpha does with a load: the PD agent on ``CarryReach-v0``, by mass and alpha."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from marl_mm.collectors.pd import PdConfig
from marl_mm.eval.intervals import bootstrap_interval
from marl_mm.eval.metrics import Row
from marl_mm.eval.sweep import SweepCell

CARRY = "CarryReach-v0"

MASSES = (0.1, 1.0, 2.0, 3.0)
"""[kg]"""

ALPHAS = (0.0, 0.25, 0.5, 0.75, 1.0)


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


def summarize_loads(rows: Sequence[Row]) -> list[Row]:
    """One row per mass and alpha, with the margin's gain over alpha 0.

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
    margins = {cell: _column(of_cell, "zmp_margin") for cell, of_cell in own.items()}
    gains = {cell: margins[cell] - margins[cell[0], alphas[0]] for cell in own}
    summary = []
    for mass, alpha in own:
        cell = mass, alpha
        more = gains[cell] - gains[masses[0], alpha]
        means = ("success", "steps", "d_mm", "base_jerk_rms", "zmp_margin")
        summary.append(
            {
                "mass": mass,
                "alpha": alpha,
                "goals": len(own[cell]),
                **{name: float(_column(own[cell], name).mean()) for name in means},
                "zmp_margin_least": float(margins[cell].min()),
                "gain": float(gains[cell].mean()),
                "gain_interval": bootstrap_interval(gains[cell]),
                "more": float(more.mean()),
                "more_interval": bootstrap_interval(more),
            }
        )
    return summary


def _column(rows: Sequence[Row], name: str) -> NDArray[np.float64]:
    return np.array([float(row[name]) for row in rows])
