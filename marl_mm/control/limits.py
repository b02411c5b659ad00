"""Every limit as rows d <= C u <= d_bar, feasible by construction.

Torque rows come first (7), then one box row per variable (9), then the keep-out plane.
A box row is the intersection of acceleration limit, velocity limit over a short horizon
and, for arm joints, the braking bound |v| <= sqrt(a (limit - q)); each bound is clamped
to the acceleration limit so that the row is never empty. The keep-out plane asks for no
more than the box can give.
"""

from dataclasses import dataclass

import numpy as np

from marl_mm.control.config import LimitConfig
from marl_mm.control.tasks.task import VARIABLES
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ACTUATED, ModelTerms, RobotState

TORQUE_ROWS = slice(0, 7)
BOX_ROWS = slice(7, 16)
KEEP_OUT_ROW = 16
ROWS = 17

LEAST_WIDTH = 2e-3
"""A box row is at least this wide [rad/s^2]."""

UNBOUNDED = 1e9
"""A bound that is none, and still a number to calculate with."""


@dataclass(frozen=True)
class Bounds:
    """Limits at one state: lower <= matrix u <= upper."""

    matrix: np.ndarray
    """C, shape (17, 9)."""

    lower: np.ndarray
    """d, shape (17,)."""

    upper: np.ndarray
    """d_bar, shape (17,)."""


def bounds(
    state: RobotState, terms: ModelTerms, robot: RobotLimits, config: LimitConfig
) -> Bounds:
    """All limits at a state."""
    matrix = np.zeros((ROWS, VARIABLES))
    lower, upper = np.zeros(ROWS), np.zeros(ROWS)
    matrix[TORQUE_ROWS] = terms.mass_matrix[3:, ACTUATED]
    lower[TORQUE_ROWS] = -robot.torque - terms.nonlinear[3:]
    upper[TORQUE_ROWS] = robot.torque - terms.nonlinear[3:]
    matrix[BOX_ROWS] = np.eye(VARIABLES)
    lower[BOX_ROWS], upper[BOX_ROWS] = acceleration_box(state, robot, config)
    matrix[KEEP_OUT_ROW] = keep_out_direction(state, terms)
    row, low, high = matrix[KEEP_OUT_ROW], lower[BOX_ROWS], upper[BOX_ROWS]
    within_box = np.where(row > 0, row * high, row * low).sum() - LEAST_WIDTH
    lower[KEEP_OUT_ROW] = min(keep_out_bound(state, terms, config), within_box)
    upper[KEEP_OUT_ROW] = UNBOUNDED
    return Bounds(matrix, lower, upper)


def acceleration_box(
    state: RobotState, robot: RobotLimits, config: LimitConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest acceleration of each variable, shapes (9,)."""
    velocity = state.v[ACTUATED]
    fastest, slowest = robot.speed.copy(), -robot.speed
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
    """X'' at u = 0 [m/s^2]: the world's bias, seen from the turning base frame."""
    heading = state.q[2:4]
    lateral = np.array([-heading[1], heading[0]])
    turning = state.v[2]
    ahead = heading @ (terms.position_w[:2] - state.q[:2])
    sideways = lateral @ terms.jacobian[:2, 3:] @ state.v[3:]
    bias = heading @ terms.bias_acceleration[:2]
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
