"""Limits of the robot: the data sheets' numbers in one record."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from marl_mm.errors import UsageError
from marl_mm.robot.description import RobotConfig, urdf_xml
from marl_mm.robot.names import ARM_JOINTS, FINGER_JOINTS, WHEEL_JOINTS

ARM_ACCELERATION = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
"""Acceleration limits of the arm joints [rad/s^2] (Franka Emika control parameters; a
URDF has no place for them)."""

BASE_SPEED = 1.0
"""Speed limit of the base [m/s] (MiR data sheet)."""

BASE_ACCELERATION = 2.0
"""Acceleration limit of the base [m/s^2] (MiR navigation parameters)."""

BASE_YAW_RATE = 1.5
"""Yaw rate limit of the base [rad/s] (MiR navigation parameters)."""

BASE_YAW_ACCELERATION = 2.5
"""Yaw acceleration limit of the base [rad/s^2] (MiR navigation parameters)."""


class RobotLimits(NamedTuple):
    """Limits in the order of the controller's variables: base (2), then arm (7)."""

    speed: np.ndarray
    """Largest absolute velocities, shape (9,): [m/s], [rad/s], seven times [rad/s]."""

    acceleration: np.ndarray
    """Largest absolute accelerations, shape (9,): [m/s^2], then [rad/s^2]."""

    lower: np.ndarray
    """Lowest arm joint positions, shape (7,) [rad]."""

    upper: np.ndarray
    """Highest arm joint positions, shape (7,) [rad]."""

    torque: np.ndarray
    """Largest absolute torques of the arm joints, shape (7,) [N m]."""

    wheel_speed: float
    """Largest absolute speed of a drive wheel [rad/s]."""


def robot_limits(config: RobotConfig) -> RobotLimits:
    """Limits from the URDF, completed by the data sheets' accelerations.

    Raises:
        UsageError: If the start posture is beyond them, or the URDF describes no robot.
    """
    xml = urdf_xml(config)
    try:
        model = pin.buildModelFromXML(xml)
    except ValueError as error:
        raise UsageError(f"miranda.urdf is no robot for Pinocchio: {error}") from None
    arm = [model.joints[model.getJointId(name)] for name in ARM_JOINTS]
    wheel = model.joints[model.getJointId(WHEEL_JOINTS[0])]
    q, v = [joint.idx_q for joint in arm], [joint.idx_v for joint in arm]
    lower, upper = model.lowerPositionLimit[q], model.upperPositionLimit[q]
    travel = model.upperPositionLimit[
        model.joints[model.getJointId(FINGER_JOINTS[0])].idx_q
    ]
    if not 0 <= config.initial_finger <= travel:
        raise UsageError(
            f"robot.initial_finger is {config.initial_finger}, expected 0 to {travel:g}"
        )
    posture = zip(ARM_JOINTS, config.initial_joints, lower, upper, strict=True)
    for name, angle, low, high in posture:
        if not low <= angle <= high:
            raise UsageError(
                f"robot.initial_joints has {name} at {angle:g} rad, expected {low:g} "
                f"to {high:g}"
            )
    return RobotLimits(
        speed=np.array([BASE_SPEED, BASE_YAW_RATE, *model.velocityLimit[v]]),
        acceleration=np.array(
            [BASE_ACCELERATION, BASE_YAW_ACCELERATION, *ARM_ACCELERATION]
        ),
        lower=lower.copy(),
        upper=upper.copy(),
        torque=model.effortLimit[v].copy(),
        wheel_speed=float(model.velocityLimit[wheel.idx_v]),
    )
