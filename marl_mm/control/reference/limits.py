"""Every limit as rows d <= C u <= d_bar, in the order of ``marl_mm.control.limits``.

A box row is the intersection of acceleration limit, velocity limit over a short horizon
and, for arm joints, the braking bound |v| <= sqrt(a (limit - q)); each bound is clamped
to the acceleration limit so that the row is never empty. The rows after it ask for no
more than the box can give. Together with the torques they may still contradict each
other; then the controller brakes (safe.py).
"""

from dataclasses import dataclass

import numpy as np

from marl_mm.control.config import LimitConfig
from marl_mm.control.limits import (
    BOX_ROWS,
    KEEP_OUT,
    LEAST_WIDTH,
    TORQUE_ROWS,
    TRACTION_ROWS,
    UNBOUNDED,
    WHEEL_ARM,
    WHEEL_ROWS,
    ZMP_ROWS,
    row_count,
)
from marl_mm.control.records import VARIABLES
from marl_mm.robot.description import WHEEL_RADIUS
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ACTUATED, ModelTerms, RobotState
from marl_mm.robot.support import SUPPORT_B, SUPPORT_INWARD_B


@dataclass(frozen=True)
class Bounds:
    """Limits at one state: lower <= matrix u <= upper."""

    matrix: np.ndarray
    """Rows C, shape (22 or 28, 9)."""

    lower: np.ndarray
    """Lower bounds d, one per row."""

    upper: np.ndarray
    """Upper bounds d_bar, one per row."""


def bounds(
    state: RobotState, terms: ModelTerms, robot: RobotLimits, config: LimitConfig
) -> Bounds:
    """All limits at a state."""
    rows = row_count(config)
    matrix = np.zeros((rows, VARIABLES))
    lower, upper = np.zeros(rows), np.full(rows, UNBOUNDED)
    matrix[TORQUE_ROWS] = terms.mass_matrix[3:, ACTUATED]
    lower[TORQUE_ROWS] = -robot.torque - terms.nonlinear[3:]
    upper[TORQUE_ROWS] = robot.torque - terms.nonlinear[3:]
    matrix[BOX_ROWS] = np.eye(VARIABLES)
    lower[BOX_ROWS], upper[BOX_ROWS] = acceleration_box(state, robot, config)
    matrix[KEEP_OUT] = keep_out_direction(state, terms)
    lower[KEEP_OUT] = keep_out_bound(state, terms, config)
    matrix[WHEEL_ROWS], lower[WHEEL_ROWS], upper[WHEEL_ROWS] = wheel_rims(
        state, robot, config
    )
    matrix[TRACTION_ROWS], force = wheel_forces(terms)
    lower[TRACTION_ROWS] = -config.traction - force
    upper[TRACTION_ROWS] = config.traction - force
    if config.zmp:
        matrix[ZMP_ROWS], lower[ZMP_ROWS] = edge_moments(state, terms, config)
    _lessen_to_box(matrix, lower, upper)
    return Bounds(matrix, lower, upper)


def acceleration_box(
    state: RobotState, robot: RobotLimits, config: LimitConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest acceleration of each variable, shapes (9,)."""
    velocity = state.v[ACTUATED]
    fastest = config.speed_share * robot.speed
    slowest = -fastest
    arm, limit = state.q[4:], robot.acceleration[2:]
    room = np.maximum(robot.upper - arm - config.joint_margin, 0.0)
    fastest[2:] = np.minimum(fastest[2:], np.sqrt(limit * room))
    room = np.maximum(arm - robot.lower - config.joint_margin, 0.0)
    slowest[2:] = np.maximum(slowest[2:], -np.sqrt(limit * room))
    most = robot.acceleration
    upper = np.clip((fastest - velocity) / config.horizon, -most, most)
    lower = np.clip((slowest - velocity) / config.horizon, -most, most)
    thin = upper - lower < LEAST_WIDTH
    middle = (lower + upper) / 2
    lower = np.where(thin, middle - LEAST_WIDTH / 2, lower)
    upper = np.where(thin, middle + LEAST_WIDTH / 2, upper)
    return lower, upper


def keep_out_direction(state: RobotState, terms: ModelTerms) -> np.ndarray:
    """Row of x'', x the end-effector's distance ahead of the base's origin, (9,).

    In the base frame only the arm moves the end-effector.
    """
    row = np.zeros(VARIABLES)
    row[2:] = state.q[2:4] @ terms.jacobian[:2, 3:]
    return row


def keep_out_bias(state: RobotState, terms: ModelTerms) -> float:
    """Acceleration x'' at u = 0 [m/s^2]: the world's bias, in the turning base."""
    heading = state.q[2:4]
    lateral = np.array([-heading[1], heading[0]])
    turning = state.v[2]
    ahead = heading @ (terms.position_w[:2] - state.q[:2])
    sideways = lateral @ terms.jacobian[:2, 3:] @ state.v[3:]
    bias = heading @ terms.bias_acceleration[:2]
    # The base's own acceleration along its heading at u = 0: a slipping base's turn.
    bias += turning * state.v[1]
    return float(bias + turning * turning * ahead + 2 * turning * sideways)


def keep_out_bound(state: RobotState, terms: ModelTerms, config: LimitConfig) -> float:
    """Least acceleration away from the column [m/s^2]: an exponential barrier.

    x'' >= -2 k x' - k^2 (x - keep_out), as far as the arm may be pushed at all.
    """
    ahead = state.q[2:4] @ (terms.position_w[:2] - state.q[:2])
    speed = keep_out_direction(state, terms)[2:] @ state.v[3:]
    rate, most = config.keep_out_rate, config.keep_out_acceleration
    bound = -2 * rate * speed - rate * rate * (ahead - config.keep_out)
    return float(np.clip(bound - keep_out_bias(state, terms), -most, most))


def wheel_rims(
    state: RobotState, robot: RobotLimits, config: LimitConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of both rims' acceleration [m/s^2], and their bounds by speed over time."""
    rows = np.zeros((2, VARIABLES))
    rows[:, 0] = 1.0
    rows[:, 1] = -WHEEL_ARM, WHEEL_ARM
    speed = rows[:, :2] @ state.v[[0, 2]]
    most = config.speed_share * robot.wheel_speed * WHEEL_RADIUS
    return rows, (-most - speed) / config.horizon, (most - speed) / config.horizon


def wheel_forces(terms: ModelTerms) -> tuple[np.ndarray, np.ndarray]:
    """Rows and bias of the ground's force on the wheels [N].

    Left along, right along, both across: what moves the base and holds it against the
    arm's reaction.
    """
    forces = np.column_stack([terms.mass_matrix[:3, ACTUATED], terms.nonlinear[:3]])
    along, across, turning = forces[0] / 2, forces[1], forces[2] / (2 * WHEEL_ARM)
    rows = np.stack([along - turning, along + turning, across])
    return rows[:, :-1], rows[:, -1]


def edge_moments(
    state: RobotState, terms: ModelTerms, config: LimitConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and lower bounds of the moments that hold the robot on the ground [N m].

    The ground's force acts at the zero-moment point. Its moment about an edge of the
    support polygon, moved inward by the margin, is the vertical force times the point's
    distance from there: linear in u, and not negative while the point is inside.
    """
    cos, sin = state.q[2:4]
    inward = SUPPORT_INWARD_B @ np.array([[cos, sin], [-sin, cos]])
    edge = (SUPPORT_INWARD_B * SUPPORT_B).sum(axis=1) + config.zmp_margin
    wrench = terms.wrench[:, [*ACTUATED, -1]]
    moment = -inward @ np.stack([wrench[4], -wrench[3]]) - np.outer(edge, wrench[2])
    return moment[:, :-1], -moment[:, -1]


def _lessen_to_box(matrix: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
    """Relax the rows after the box to the most that the box can give."""
    rest = slice(KEEP_OUT, None)
    low, high = matrix[rest] * lower[BOX_ROWS], matrix[rest] * upper[BOX_ROWS]
    most = np.maximum(low, high).sum(axis=1) - LEAST_WIDTH
    least = np.minimum(low, high).sum(axis=1) + LEAST_WIDTH
    lower[rest] = np.minimum(lower[rest], most)
    upper[rest] = np.maximum(upper[rest], least)
