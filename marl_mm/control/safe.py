"""The safe command, for states in which no acceleration meets all limits.

Base and joints brake within the box; the torques carry the arm's weight as always, as
far as they reach.
"""

import numpy as np

from marl_mm.control.limits import BOX_ROWS, Bounds
from marl_mm.robot.model import ACTUATED, RobotState

BRAKING_RATE = 10.0
"""Speed to deceleration [1/s]."""


def braking_acceleration(state: RobotState, limits: Bounds) -> np.ndarray:
    """U that brings base and arm to rest, shape (9,)."""
    wanted = -BRAKING_RATE * state.v[ACTUATED]
    braking: np.ndarray = np.clip(
        wanted, limits.lower[BOX_ROWS], limits.upper[BOX_ROWS]
    )
    return braking
