"""Rows of all tasks and all limits at one state, compiled.

Tasks in Table 1's order: base velocity, base orientation, manipulator position (3),
manipulator orientation (3), arm posture (7). Limits in the order of control/limits.py.
"""

import numpy as np

from marl_mm.control.config import Gains, LimitConfig
from marl_mm.control.limits import (
    BOX,
    KEEP_OUT,
    LEAST_WIDTH,
    TRACTION,
    UNBOUNDED,
    WHEEL_ARM,
    WHEELS,
    ZMP,
)
from marl_mm.control.records import VARIABLES, Reference
from marl_mm.jit import jit, on_stack
from marl_mm.robot.description import WHEEL_RADIUS
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ModelTerms, RobotState
from marl_mm.robot.support import SUPPORT_B, SUPPORT_INWARD_B

TASK_ROWS = 15
"""Rows of all five tasks."""

_vector, _matrix = on_stack(3), on_stack(3, 3)


@jit
def clip(value: float, low: float, high: float) -> float:
    """Value between two bounds."""
    return min(max(value, low), high)


@jit
def assemble_tasks(
    state: RobotState,
    terms: ModelTerms,
    reference: Reference,
    gains: Gains,
    jacobian: np.ndarray,
    target: np.ndarray,
) -> None:
    """Write all tasks' rows: jacobian (15, 9), target (15,), in Table 1's order."""
    q, v = state.q, state.v
    cos, sin = q[2], q[3]
    jacobian[0, 0] = 1.0
    jacobian[1, 1] = 1.0
    for i in range(6):
        jacobian[2 + i, 0] = terms.jacobian[i, 0]
        jacobian[2 + i, 1] = terms.jacobian[i, 2]
        for j in range(7):
            jacobian[2 + i, 2 + j] = terms.jacobian[i, 3 + j]
    for j in range(7):
        jacobian[8 + j, 2 + j] = 1.0

    ahead = (reference.base_position_w[0] - q[0]) * cos
    ahead += (reference.base_position_w[1] - q[1]) * sin
    catch = clip(gains.base_rate * ahead, -gains.base_catch, gains.base_catch)
    target[0] = gains.base_speed_rate * (reference.base_speed + catch - v[0])

    error = reference.base_heading - np.arctan2(sin, cos)
    error = np.arctan2(np.sin(error), np.cos(error))
    rate = gains.heading_rate
    target[1] = rate * rate * error - 2 * rate * v[2]

    position = terms.position_w
    offset = _vector()
    for i in range(3):
        offset[i] = reference.ee_position_w[i] - position[i]
    distance = np.sqrt(offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
    rate = gains.ee_rate
    if rate * distance > gains.ee_speed:
        rate = gains.ee_speed / distance
    for i in range(3):
        feedback = rate * offset[i] - terms.velocity_w[i]
        target[2 + i] = gains.ee_speed_rate * feedback - terms.bias_acceleration[i]

    turn = _vector()
    _write_rotation_error(terms.rotation_w, reference.ee_rotation_w, turn)
    rate = gains.ee_rotation_rate
    for i in range(3):
        feedback = rate * rate * turn[i] - 2 * rate * terms.velocity_w[3 + i]
        target[5 + i] = feedback - terms.bias_acceleration[3 + i]

    rate = gains.posture_rate
    for j in range(7):
        error = reference.posture[j] - q[4 + j]
        target[8 + j] = rate * rate * error - 2 * rate * v[3 + j]


@jit
def _write_rotation_error(
    rotation_w: np.ndarray, target_w: np.ndarray, vector: np.ndarray
) -> None:
    relative = _matrix()
    relative[:] = 0.0
    for i in range(3):
        for j in range(3):
            for k in range(3):
                relative[i, j] += rotation_w[k, i] * target_w[k, j]
    cosine = clip((relative[0, 0] + relative[1, 1] + relative[2, 2] - 1) / 2, -1.0, 1.0)
    angle = np.arccos(cosine)
    x = relative[2, 1] - relative[1, 2]
    y = relative[0, 2] - relative[2, 0]
    z = relative[1, 0] - relative[0, 1]
    if angle < 1e-4:
        scale = 0.5
    elif angle < 3.1:
        scale = angle / (2 * np.sin(angle))
    else:  # where these vanish, a column of (R + R') / 2 - cos I tells the axis
        k = 0
        for i in range(1, 3):
            if relative[i, i] > relative[k, k]:
                k = i
        length = np.sqrt((1 - cosine) * (relative[k, k] - cosine))
        scale = -angle / length if (x, y, z)[k] < 0 else angle / length
        x = (relative[0, k] + relative[k, 0]) / 2 - cosine * (k == 0)
        y = (relative[1, k] + relative[k, 1]) / 2 - cosine * (k == 1)
        z = (relative[2, k] + relative[k, 2]) / 2 - cosine * (k == 2)
    x, y, z = scale * x, scale * y, scale * z
    for i in range(3):
        vector[i] = rotation_w[i, 0] * x + rotation_w[i, 1] * y + rotation_w[i, 2] * z


@jit
def assemble_limits(
    state: RobotState,
    terms: ModelTerms,
    robot: RobotLimits,
    config: LimitConfig,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> None:
    """Write all limit rows: matrix (rows, 9), lower and upper (rows,)."""
    for i in range(7):
        matrix[i, 0] = terms.mass_matrix[3 + i, 0]
        matrix[i, 1] = terms.mass_matrix[3 + i, 2]
        for j in range(7):
            matrix[i, 2 + j] = terms.mass_matrix[3 + i, 3 + j]
        lower[i] = -robot.torque[i] - terms.nonlinear[3 + i]
        upper[i] = robot.torque[i] - terms.nonlinear[3 + i]
    _box(state, robot, config, matrix, lower, upper)
    _keep_out(state, terms, config, matrix, lower, upper)
    _wheel_rims(state, robot, config, matrix, lower, upper)
    _wheel_forces(terms, config, matrix, lower, upper)
    if config.zmp:
        _edge_moments(state, terms, config, matrix, lower, upper)
    for i in range(KEEP_OUT, len(lower)):
        most, least = -LEAST_WIDTH, LEAST_WIDTH
        for j in range(VARIABLES):
            low, high = matrix[i, j] * lower[BOX + j], matrix[i, j] * upper[BOX + j]
            most += max(low, high)
            least += min(low, high)
        lower[i], upper[i] = min(lower[i], most), max(upper[i], least)


@jit
def _box(
    state: RobotState,
    robot: RobotLimits,
    config: LimitConfig,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> None:
    q, v = state.q, state.v
    for j in range(VARIABLES):
        matrix[BOX + j, j] = 1.0
        most = robot.acceleration[j]
        fastest = config.speed_share * robot.speed[j]
        slowest = -fastest
        velocity = v[0] if j == 0 else v[1 + j]
        if j >= 2:
            room = robot.upper[j - 2] - q[2 + j] - config.joint_margin
            fastest = min(fastest, np.sqrt(most * max(room, 0.0)))
            room = q[2 + j] - robot.lower[j - 2] - config.joint_margin
            slowest = max(slowest, -np.sqrt(most * max(room, 0.0)))
        high = clip((fastest - velocity) / config.horizon, -most, most)
        low = clip((slowest - velocity) / config.horizon, -most, most)
        if high - low < LEAST_WIDTH:
            middle = (low + high) / 2
            low, high = middle - LEAST_WIDTH / 2, middle + LEAST_WIDTH / 2
        lower[BOX + j], upper[BOX + j] = low, high


@jit
def _keep_out(
    state: RobotState,
    terms: ModelTerms,
    config: LimitConfig,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> None:
    q, v = state.q, state.v
    cos, sin = q[2], q[3]
    ahead = cos * (terms.position_w[0] - q[0]) + sin * (terms.position_w[1] - q[1])
    row = matrix[KEEP_OUT]
    speed = sideways = 0.0
    for j in range(7):
        dx, dy = terms.jacobian[0, 3 + j], terms.jacobian[1, 3 + j]
        row[2 + j] = cos * dx + sin * dy
        speed += row[2 + j] * v[3 + j]
        sideways += (cos * dy - sin * dx) * v[3 + j]
    bias = cos * terms.bias_acceleration[0] + sin * terms.bias_acceleration[1]
    bias += v[2] * v[1] + v[2] * v[2] * ahead + 2 * v[2] * sideways
    rate, most = config.keep_out_rate, config.keep_out_acceleration
    bound = -2 * rate * speed - rate * rate * (ahead - config.keep_out) - bias
    lower[KEEP_OUT], upper[KEEP_OUT] = clip(bound, -most, most), UNBOUNDED


@jit
def _wheel_rims(
    state: RobotState,
    robot: RobotLimits,
    config: LimitConfig,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> None:
    most = config.speed_share * robot.wheel_speed * WHEEL_RADIUS
    for i in range(2):
        arm = WHEEL_ARM if i else -WHEEL_ARM
        row = WHEELS + i
        matrix[row, 0], matrix[row, 1] = 1.0, arm
        speed = state.v[0] + arm * state.v[2]
        lower[row] = (-most - speed) / config.horizon
        upper[row] = (most - speed) / config.horizon


@jit
def _wheel_forces(
    terms: ModelTerms,
    config: LimitConfig,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> None:
    mass, bias = terms.mass_matrix, terms.nonlinear
    for j in range(VARIABLES):
        k = 0 if j == 0 else j + 1
        along, turning = mass[0, k] / 2, mass[2, k] / (2 * WHEEL_ARM)
        matrix[TRACTION, j] = along - turning
        matrix[TRACTION + 1, j] = along + turning
        matrix[TRACTION + 2, j] = mass[1, k]
    along, turning = bias[0] / 2, bias[2] / (2 * WHEEL_ARM)
    for i, force in enumerate((along - turning, along + turning, bias[1])):
        lower[TRACTION + i] = -config.traction - force
        upper[TRACTION + i] = config.traction - force


@jit
def _edge_moments(
    state: RobotState,
    terms: ModelTerms,
    config: LimitConfig,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> None:
    cos, sin = state.q[2], state.q[3]
    wrench = terms.wrench
    for e in range(len(SUPPORT_B)):
        nx, ny = SUPPORT_INWARD_B[e]
        edge = nx * SUPPORT_B[e, 0] + ny * SUPPORT_B[e, 1] + config.zmp_margin
        nx, ny = cos * nx - sin * ny, sin * nx + cos * ny
        row = ZMP + e
        for j in range(VARIABLES + 1):
            k = 0 if j == 0 else j + 1
            moment = ny * wrench[3, k] - nx * wrench[4, k] - edge * wrench[2, k]
            if j < VARIABLES:
                matrix[row, j] = moment
            else:
                lower[row] = -moment
        upper[row] = UNBOUNDED
