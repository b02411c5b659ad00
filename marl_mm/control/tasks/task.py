"""What every task is: A u = b, linear in the controller's variables u."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

VARIABLES = 9
"""u: base forward [m/s^2], base yaw [rad/s^2], seven arm joints [rad/s^2]."""


@dataclass(frozen=True)
class Task:
    """One task at one state: the acceleration it wants, A u = b."""

    name: str

    jacobian: np.ndarray
    """A, shape (rows, 9)."""

    target: np.ndarray
    """b, shape (rows,): feedback acceleration minus the bias Jdot v."""


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
