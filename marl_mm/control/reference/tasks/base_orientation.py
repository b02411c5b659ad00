"""Keep the heading: e = wrapped heading error, Jacobian (0, 1, 0, ... 0)."""

import numpy as np

from marl_mm.control.config import Gains
from marl_mm.control.records import VARIABLES, Reference
from marl_mm.control.reference.tasks.task import Task
from marl_mm.robot.model import RobotState


def base_orientation(state: RobotState, reference: Reference, gains: Gains) -> Task:
    """Task with one row [rad/s^2], critically damped."""
    error = reference.base_heading - state.yaw
    error = np.arctan2(np.sin(error), np.cos(error))
    rate = gains.heading_rate
    jacobian = np.zeros((1, VARIABLES))
    jacobian[0, 1] = 1.0
    target = np.array([rate * rate * error - 2 * rate * state.v[2]])
    return Task("base orientation", jacobian, target)
