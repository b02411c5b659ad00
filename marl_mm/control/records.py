"""Inputs and output of the controller: reference, priorities and command."""

from typing import NamedTuple

import numpy as np

from marl_mm.control.limits import LIMIT_NAMES

VARIABLES = 9
"""Number of variables u: base forward [m/s^2], base yaw [rad/s^2], seven arm joints
[rad/s^2]."""


class Reference(NamedTuple):
    """Targets of the tasks at one tick."""

    ee_position_w: np.ndarray
    """Target of the end-effector, shape (3,) [m]."""

    ee_rotation_w: np.ndarray
    """Target axes of the end-effector as columns, shape (3, 3)."""

    base_position_w: np.ndarray
    """Position of the base plan, shape (2,) [m]."""

    base_heading: float
    """Heading to keep [rad]."""

    base_speed: float
    """Speed of the base plan along the heading [m/s]."""

    posture: np.ndarray
    """Posture that the arm returns to, shape (7,) [rad]."""


class Priorities(NamedTuple):
    """Priorities of the tasks: one hierarchy, or a mix of several."""

    matrices: np.ndarray
    """Cumulative priority matrices, shape (m, 4, 5)."""

    shares: np.ndarray
    """Weight of each hierarchy's solution in u, shape (m,)."""


class Command(NamedTuple):
    """Command to the robot until the next tick."""

    acceleration: np.ndarray
    """Acceleration u, shape (9,)."""

    torque: np.ndarray
    """Torques of the arm joints, clipped to their limits, shape (7,) [N m]."""

    base_speed: tuple[float, float]
    """Base speeds for the wheels: forward [m/s], yaw rate [rad/s]. The measured speeds
    plus u over a tick: an integral of u alone would go on while the wheels slip, and
    jerk the base when they grip again."""

    levels: int
    """Number of levels solved."""

    qps: int
    """Number of levels that needed a QP, as the closed form broke a limit."""

    failures: int
    """Number of levels whose QP failed, and which were skipped."""

    cause: int
    """Row of the limits behind the last failure, see ``reason``."""

    safe: bool
    """Whether no acceleration met all limits, so that the command only brakes."""

    @property
    def reason(self) -> str | None:
        """Limit behind the last failed level, in words.

        Of a command that only brakes, the limit that braking breaks most.
        """
        if self.failures == 0:
            return None
        if self.cause < 0:
            return "the QP ran out of iterations"
        return f"{LIMIT_NAMES[self.cause]}: out of reach within the other limits"
