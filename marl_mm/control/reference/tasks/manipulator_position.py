"""Bring the end-effector to its target: e = target - position, world frame.

The velocity wanted is proportional to e and limited in norm; the Jacobian is the linear
half of the frame's, without the lateral column.
"""

import numpy as np

from marl_mm.control.config import Gains
from marl_mm.control.records import Reference
from marl_mm.control.reference.tasks.task import Task
from marl_mm.robot.model import ACTUATED, ModelTerms


def manipulator_position(terms: ModelTerms, reference: Reference, gains: Gains) -> Task:
    """Task with three rows [m/s^2]."""
    error = reference.ee_position_w - terms.position_w
    distance = float(np.linalg.norm(error))
    rate = gains.ee_rate
    if rate * distance > gains.ee_speed:
        rate = gains.ee_speed / distance
    feedback = gains.ee_speed_rate * (rate * error - terms.velocity_w[:3])
    return Task(
        "manipulator position",
        terms.jacobian[:3, ACTUATED],
        feedback - terms.bias_acceleration[:3],
    )
