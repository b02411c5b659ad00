"""The safe command, for states in which no acceleration meets all limits.

Base and joints brake within the box, no harder than the torques allow beside carrying
the arm: all braking is scaled alike, since a clipped torque would throw other joints.
"""

import numpy as np

from marl_mm.control.config import BRAKING_RATE
from marl_mm.control.limits import BOX, BOX_ROWS, TORQUE
from marl_mm.control.reference.limits import Bounds
from marl_mm.robot.model import ACTUATED, RobotState


def braking_acceleration(state: RobotState, limits: Bounds) -> np.ndarray:
    """Acceleration u that brings base and arm to rest, shape (9,)."""
    wanted = -BRAKING_RATE * state.v[ACTUATED]
    braking: np.ndarray = np.clip(
        wanted, limits.lower[BOX_ROWS], limits.upper[BOX_ROWS]
    )
    share = 1.0
    for row in range(TORQUE, BOX):
        torque = limits.matrix[row] @ braking
        room = limits.upper[row] if torque > 0 else limits.lower[row]
        if room * torque > 0:  # else the weight alone is too much, braking or not
            share = min(share, room / torque)
    return share * braking


def broken_row(u: np.ndarray, limits: Bounds) -> int | None:
    """The limit that u is furthest outside of, by the acceleration it would take."""
    value = limits.matrix @ u
    excess = np.maximum(limits.lower - value, value - limits.upper)
    norm = np.linalg.norm(limits.matrix, axis=1)
    distance = excess / np.maximum(norm, 1e-9)
    worst = int(np.argmax(distance))
    return worst if distance[worst] > 0 else None
