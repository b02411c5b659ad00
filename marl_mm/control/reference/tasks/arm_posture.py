"""Return the arm to its initial joints: e = posture - joints, Jacobian (0 | I)."""

import numpy as np

from marl_mm.control.config import Gains
from marl_mm.control.records import VARIABLES, Reference
from marl_mm.control.reference.tasks.task import Task
from marl_mm.robot.model import RobotState


def arm_posture(state: RobotState, reference: Reference, gains: Gains) -> Task:
    """Task with seven rows [rad/s^2], critically damped."""
    rate = gains.posture_rate
    error = reference.posture - state.q[4:]
    jacobian = np.zeros((7, VARIABLES))
    jacobian[:, 2:] = np.eye(7)
    target = rate * rate * error - 2 * rate * state.v[3:]
    return Task("arm posture", jacobian, target)
