"""What the controller takes and returns: reference, priorities and command."""

from typing import NamedTuple

import numpy as np

from marl_mm.control.limits import LIMIT_NAMES

VARIABLES = 9
"""u: base forward [m/s^2], base yaw [rad/s^2], seven arm joints [rad/s^2]."""


class Reference(NamedTuple):
    """Where the tasks shall bring the robot at this tick."""

    ee_position_w: np.ndarray
    """End-effector, shape (3,) [m]."""

    ee_rotation_w: np.ndarray
    """End-effector's axes as columns, shape (3, 3)."""

    base_position_w: np.ndarray
    """Base plan at this tick, shape (2,) [m]."""

    base_heading: float
    """Heading to keep [rad]."""

    base_speed: float
    """Speed of the base plan along the heading [m/s]."""

    posture: np.ndarray
    """Arm joints to return to, shape (7,) [rad]."""


class Priorities(NamedTuple):
    """Who comes first: one hierarchy, or a mix of several."""

    matrices: np.ndarray
    """Cumulative priority matrices, shape (m, 4, 5)."""

    shares: np.ndarray
    """Weight of each hierarchy's solution in u, shape (m,)."""


class Command(NamedTuple):
    """What the robot shall do until the next tick."""

    acceleration: np.ndarray
    """u, shape (9,)."""

    torque: np.ndarray
    """Of the arm joints, clipped to their limits, shape (7,) [N m]."""

    base_speed: tuple[float, float]
    """For the wheels: forward [m/s], yaw rate [rad/s]. The measured speeds plus u over
    a tick: an integral of u alone would go on while the wheels slip, and jerk the base
    when they grip again."""

    levels: int
    """Levels of the hierarchy solved."""

    qps: int
    """Levels that needed a QP, because the closed form broke a limit."""

    failures: int
    """Levels whose QP failed, and which were skipped."""

    cause: int
    """The last failure's, see ``reason``."""

    safe: bool
    """Whether no acceleration met all limits, so that the command only brakes."""

    @property
    def reason(self) -> str | None:
        """What stood in the way of the last failed level, in words.

        Of a command that only brakes: the limit that even braking breaks, most of all.
        """
        if self.failures == 0:
            return None
        if self.cause < 0:
            return "the QP ran out of iterations"
        return f"{LIMIT_NAMES[self.cause]}: out of reach within the other limits"
