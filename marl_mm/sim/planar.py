"""Between the simulator's floating base on wheels and the controller's planar base."""

from collections.abc import Sequence
from math import asin, atan2

import numpy as np

from marl_mm.errors import NonFiniteStateError
from marl_mm.jit import jit
from marl_mm.robot.description import WHEEL_RADIUS, WHEEL_SEPARATION


def diverged(q: np.ndarray, v: np.ndarray) -> NonFiniteStateError:
    """Error of a state that is not finite: q (11,) and v (10,) of ``RobotState``."""
    return NonFiniteStateError(
        f"the simulation diverged: q = {q.tolist()}, v = {v.tolist()}"
    )


def attitude(quaternion: tuple[float, ...]) -> tuple[float, float]:
    """Roll and pitch of an orientation x, y, z, w [rad]."""
    x, y, z, w = quaternion
    roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return roll, asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))


def rim_rates(forward: float, yaw_rate: float) -> tuple[float, float]:
    """Rates of the left and the right wheel [rad/s] at the base's speeds.

    Args:
        forward: Base speed [m/s].
        yaw_rate: Base turning rate [rad/s].
    """
    turn = yaw_rate * WHEEL_SEPARATION / 2
    return (forward - turn) / WHEEL_RADIUS, (forward + turn) / WHEEL_RADIUS


@jit
def planar_state(
    position_w: tuple[float, ...],
    quaternion: tuple[float, ...],
    linear_w: tuple[float, ...],
    angular_w: tuple[float, ...],
    com_b: tuple[float, ...],
    joints: Sequence[float] | np.ndarray,
    rates: Sequence[float] | np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
) -> bool:
    """Write q (11,) and v (10,) of ``RobotState``; False where they are not finite.

    Args:
        position_w: Centre of mass of the base link, shape (3,) [m].
        quaternion: Orientation of the base link: x, y, z, w.
        linear_w: Velocity of the centre of mass, shape (3,) [m/s].
        angular_w: Angular velocity of the base link, shape (3,) [rad/s].
        com_b: Centre of mass in the base frame, shape (3,) [m].
        joints: Angles of the arm joints, shape (7,) [rad].
        rates: Rates of the arm joints, shape (7,) [rad/s].
        q: Resulting configuration.
        v: Resulting velocity.
    """
    x, y, z, w = quaternion
    cx, cy, cz = com_b
    r00, r01, r02 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    r10, r11, r12 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    r20, r21, r22 = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    dx = r00 * cx + r01 * cy + r02 * cz
    dy = r10 * cx + r11 * cy + r12 * cz
    dz = r20 * cx + r21 * cy + r22 * cz
    wx, wy, wz = angular_w
    vx = linear_w[0] - (wy * dz - wz * dy)
    vy = linear_w[1] - (wz * dx - wx * dz)
    norm = np.sqrt(r00 * r00 + r10 * r10)
    cos, sin = r00 / norm, r10 / norm
    q[0], q[1], q[2], q[3] = position_w[0] - dx, position_w[1] - dy, cos, sin
    v[0], v[1], v[2] = cos * vx + sin * vy, -sin * vx + cos * vy, wz
    total = q[0] + q[1] + cos + sin + v[0] + v[1] + wz
    for j in range(7):
        q[4 + j], v[3 + j] = joints[j], rates[j]
        total += joints[j] + rates[j]
    return bool(np.isfinite(total))
