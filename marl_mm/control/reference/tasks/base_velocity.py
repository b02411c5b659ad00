"""Follow the base plan: e = speed wanted - forward speed, Jacobian (1, 0, ... 0).

The wanted speed is the plan's own plus a bounded correction of the distance to the plan
along the heading; across it a differential drive cannot move.
"""

import numpy as np

from marl_mm.control.config import Gains
from marl_mm.control.records import VARIABLES, Reference
from marl_mm.control.reference.tasks.task import Task
from marl_mm.robot.model import RobotState


def base_velocity(state: RobotState, reference: Reference, gains: Gains) -> Task:
    """Task with one row [m/s^2]."""
    q, v = state
    offset = reference.base_position_w - q[:2]
    ahead = offset[0] * q[2] + offset[1] * q[3]
    correction = np.clip(gains.base_rate * ahead, -gains.base_catch, gains.base_catch)
    wanted = reference.base_speed + correction
    jacobian = np.zeros((1, VARIABLES))
    jacobian[0, 0] = 1.0
    return Task("base velocity", jacobian, gains.base_speed_rate * (wanted - v[:1]))
