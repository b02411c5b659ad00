"""What alpha does with a load: the PD agent on ``CarryReach-v0``, by mass and alpha."""

from collections.abc import Sequence

import numpy as np

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
    """One row per mass and alpha, with the margin's gain over alpha 0, goal by goal."""
    summary = []
    for mass in sorted({row["mass"] for row in rows}):
        margins = {}
        for alpha in sorted({row["alpha"] for row in rows}):
            own = sorted(
                (row for row in rows if (row["mass"], row["alpha"]) == (mass, alpha)),
                key=lambda row: row["goal"],
            )
            margin = margins[alpha] = np.array([row["zmp_margin"] for row in own])
            gain = margin - margins[min(margins)]
            summary.append(
                {
                    "mass": mass,
                    "alpha": alpha,
                    "goals": len(own),
                    "success": float(np.mean([row["success"] for row in own])),
                    "steps": float(np.mean([row["steps"] for row in own])),
                    "d_mm": float(np.mean([row["d_mm"] for row in own])),
                    "base_jerk_rms": float(
                        np.mean([row["base_jerk_rms"] for row in own])
                    ),
                    "zmp_margin": float(margin.mean()),
                    "zmp_margin_least": float(margin.min()),
                    "gain": float(gain.mean()),
                    "gain_interval": bootstrap_interval(gain),
                }
            )
    return summary
