"""Keep the end-effector's axes: e = log3(R' R_target), turned into the world frame."""

import numpy as np

from marl_mm.control.config import Gains
from marl_mm.control.records import Reference
from marl_mm.control.reference.tasks.task import Task
from marl_mm.robot.model import ACTUATED, ModelTerms


def rotation_error(rotation_w: np.ndarray, target_w: np.ndarray) -> np.ndarray:
    """Rotation vector from one orientation to another, world axes, shape (3,) [rad].

    At half a turn the axis has two signs, of which it is either.
    """
    relative = rotation_w.T @ target_w
    cosine = np.clip((np.trace(relative) - 1) / 2, -1.0, 1.0)
    angle = np.arccos(cosine)
    skew = relative - relative.T
    axis = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    if angle < 1e-4:
        scale = 0.5
    elif angle < 3.1:
        scale = angle / (2 * np.sin(angle))
    else:  # where it vanishes, (R + R') / 2 - cos I is (1 - cos) axis axis'
        square = (relative + relative.T) / 2 - cosine * np.eye(3)
        k = square.diagonal().argmax()
        scale = angle / np.sqrt((1 - cosine) * square[k, k])
        scale, axis = -scale if axis[k] < 0 else scale, square[:, k]
    vector: np.ndarray = rotation_w @ (scale * axis)
    return vector


def manipulator_orientation(
    terms: ModelTerms, reference: Reference, gains: Gains
) -> Task:
    """Task with three rows [rad/s^2], critically damped."""
    error = rotation_error(terms.rotation_w, reference.ee_rotation_w)
    rate = gains.ee_rotation_rate
    feedback = rate * rate * error - 2 * rate * terms.velocity_w[3:]
    return Task(
        "manipulator orientation",
        terms.jacobian[3:, ACTUATED],
        feedback - terms.bias_acceleration[3:],
    )
