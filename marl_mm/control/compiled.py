"""The controller's tick in one compiled call: assembly, levels, torques.

The same mathematics as tasks/, limits.py and hierarchy.py, which explain it and which
the tests compare it with; here in loops over preallocated rows, because at 240 Hz and
n = 9 the cost of Python and numpy calls exceeds that of the arithmetic twenty times.
"""

import numpy as np

from marl_mm.control.active_set import (
    cholesky,
    solve_least_distance,
    solve_lower,
    solve_upper,
)
from marl_mm.control.config import Gains, HierarchyConfig, LimitConfig
from marl_mm.control.jit import jit
from marl_mm.control.priorities import HANDLED
from marl_mm.control.tasks.task import Reference
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ModelTerms, RobotState

N = 9
TASK_ROWS = 15
LIMIT_ROWS = 17
TASK_OF_ROW = np.array([0, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4])

_DEPENDENT = 1e-10
_LEAST_WIDTH = 2e-3

LEVELS, QPS, FAILURES = range(3)
"""Entries of the counters."""


@jit
def _clip(value: float, low: float, high: float) -> float:
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
    catch = _clip(gains.base_rate * ahead, -gains.base_catch, gains.base_catch)
    target[0] = gains.base_speed_rate * (reference.base_speed + catch - v[0])

    error = reference.base_heading - np.arctan2(sin, cos)
    error = np.arctan2(np.sin(error), np.cos(error))
    rate = gains.heading_rate
    target[1] = rate * rate * error - 2 * rate * v[2]

    position = terms.position_w
    offset = np.empty(3)
    for i in range(3):
        offset[i] = reference.hand_position_w[i] - position[i]
    distance = np.sqrt(offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
    rate = gains.hand_rate
    if rate * distance > gains.hand_speed:
        rate = gains.hand_speed / distance
    for i in range(3):
        feedback = rate * offset[i] - terms.velocity_w[i]
        target[2 + i] = gains.hand_speed_rate * feedback - terms.bias_acceleration[i]

    turn = _rotation_error(terms.rotation_w, reference.hand_rotation_w)
    rate = gains.hand_rotation_rate
    for i in range(3):
        feedback = rate * rate * turn[i] - 2 * rate * terms.velocity_w[3 + i]
        target[5 + i] = feedback - terms.bias_acceleration[3 + i]

    rate = gains.posture_rate
    for j in range(7):
        error = reference.posture[j] - q[4 + j]
        target[8 + j] = rate * rate * error - 2 * rate * v[3 + j]


@jit
def _rotation_error(rotation_w: np.ndarray, target_w: np.ndarray) -> np.ndarray:
    relative = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                relative[i, j] += rotation_w[k, i] * target_w[k, j]
    cosine = _clip(
        (relative[0, 0] + relative[1, 1] + relative[2, 2] - 1) / 2, -1.0, 1.0
    )
    angle = np.arccos(cosine)
    if angle < 1e-4:
        scale = 0.5
    elif angle < 3.1:
        scale = angle / (2 * np.sin(angle))
    else:
        scale = 1.0
    x = scale * (relative[2, 1] - relative[1, 2])
    y = scale * (relative[0, 2] - relative[2, 0])
    z = scale * (relative[1, 0] - relative[0, 1])
    vector = np.empty(3)
    for i in range(3):
        vector[i] = rotation_w[i, 0] * x + rotation_w[i, 1] * y + rotation_w[i, 2] * z
    return vector


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
    """Write all limit rows: matrix (17, 9), lower and upper (17,)."""
    q, v = state.q, state.v
    for i in range(7):
        matrix[i, 0] = terms.mass_matrix[3 + i, 0]
        matrix[i, 1] = terms.mass_matrix[3 + i, 2]
        for j in range(7):
            matrix[i, 2 + j] = terms.mass_matrix[3 + i, 3 + j]
        lower[i] = -robot.torque[i] - terms.nonlinear[3 + i]
        upper[i] = robot.torque[i] - terms.nonlinear[3 + i]

    for j in range(N):
        matrix[7 + j, j] = 1.0
        most = robot.acceleration[j]
        fastest, slowest = robot.speed[j], -robot.speed[j]
        velocity = v[0] if j == 0 else v[1 + j]
        if j >= 2:
            room = robot.upper[j - 2] - q[2 + j] - config.joint_margin
            fastest = min(fastest, np.sqrt(most * max(room, 0.0)))
            room = q[2 + j] - robot.lower[j - 2] - config.joint_margin
            slowest = max(slowest, -np.sqrt(most * max(room, 0.0)))
        high = _clip((fastest - velocity) / config.horizon, -most, most)
        low = _clip((slowest - velocity) / config.horizon, -most, most)
        if high - low < _LEAST_WIDTH:
            middle = (low + high) / 2
            low, high = middle - _LEAST_WIDTH / 2, middle + _LEAST_WIDTH / 2
        lower[7 + j], upper[7 + j] = low, high

    cos, sin = q[2], q[3]
    ahead = cos * (terms.position_w[0] - q[0]) + sin * (terms.position_w[1] - q[1])
    speed = 0.0
    for j in range(7):
        matrix[16, 2 + j] = (
            cos * terms.jacobian[0, 3 + j] + sin * terms.jacobian[1, 3 + j]
        )
        speed += matrix[16, 2 + j] * v[3 + j]
    bias = cos * terms.bias_acceleration[0] + sin * terms.bias_acceleration[1]
    rate, most = config.keep_out_rate, config.keep_out_acceleration
    bound = -2 * rate * speed - rate * rate * (ahead - config.keep_out) - bias
    lower[16] = _clip(bound, -most, most - 0.1)
    upper[16] = most


@jit
def solve_hierarchy(
    jacobian: np.ndarray,
    target: np.ndarray,
    psi: np.ndarray,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    config: HierarchyConfig,
    u: np.ndarray,
    counters: np.ndarray,
) -> None:
    """All levels of a priority matrix; writes u (9,) and adds to the counters (3,)."""
    u[:] = 0.0
    projector = np.eye(N)
    projected = np.empty((TASK_ROWS, N))
    basis = np.empty((TASK_ROWS, N))
    hessian = np.empty((N, N))
    factor = np.empty((N, N))
    gradient = np.empty(N)
    x = np.empty(N)
    rows = np.empty((LIMIT_ROWS, N))
    low = np.empty(LIMIT_ROWS)
    high = np.empty(LIMIT_ROWS)
    order = np.empty(TASK_ROWS, np.int64)
    weight = np.empty(TASK_ROWS)
    share = np.empty(TASK_ROWS)
    for level in range(psi.shape[0]):
        count = _handled_rows(psi, level, order, weight, share)
        if count == 0:
            continue
        counters[LEVELS] += 1
        for a in range(count):
            r = order[a]
            for j in range(N):
                if level == 0:  # P = I
                    projected[a, j] = jacobian[r, j]
                else:
                    value = 0.0
                    for k in range(N):
                        value += jacobian[r, k] * projector[k, j]
                    projected[a, j] = value
        rho = config.rho if level > 0 else 0.0
        for i in range(N):
            gradient[i] = 0.0
            for j in range(i + 1):
                value = 0.0
                for a in range(count):
                    value += weight[a] * projected[a, i] * projected[a, j]
                if rho > 0.0:
                    for k in range(N):
                        value -= rho * projector[k, i] * projector[k, j]
                if i == j:
                    value += rho + config.damping
                hessian[i, j] = value
        for a in range(count):
            r = order[a]
            residual = target[r]
            for k in range(N):
                residual -= jacobian[r, k] * u[k]
            for j in range(N):
                gradient[j] -= weight[a] * residual * projected[a, j]
        cholesky(hessian, factor, N)
        for j in range(N):
            x[j] = -gradient[j]
        solve_lower(factor, x, N)
        solve_upper(factor, x, N)

        broken = False
        for i in range(LIMIT_ROWS):
            value = used = 0.0
            for j in range(N):
                entry = matrix[i, j]
                if level > 0:
                    entry = 0.0
                    for k in range(N):
                        entry += matrix[i, k] * projector[k, j]
                rows[i, j] = entry
                value += entry * x[j]
                used += matrix[i, j] * u[j]
            low[i], high[i] = lower[i] - used, upper[i] - used
            if level > 0:
                low[i] = min(low[i], 0.0) - config.margin
                high[i] = max(high[i], 0.0) + config.margin
            broken |= value > high[i] + config.tolerance
            broken |= value < low[i] - config.tolerance
        if broken:
            counters[QPS] += 1
            solved = _solve_limited(
                factor, gradient, rows, low, high, x, config.iterations
            )
            if not solved:
                counters[FAILURES] += 1
                for j in range(N):
                    x[j] = 0.0 if level else _clip(0.0, lower[7 + j], upper[7 + j])
        for i in range(N):
            value = 0.0
            for k in range(N):
                value += projector[i, k] * x[k]
            u[i] += value
        if level < psi.shape[0] - 1:
            _reduce(projector, projected, share, count, basis, config.projector_damping)


@jit
def _handled_rows(
    psi: np.ndarray,
    level: int,
    order: np.ndarray,
    weight: np.ndarray,
    share: np.ndarray,
) -> int:
    """Rows of the tasks whose psi rises here, highest psi first (stable)."""
    count = 0
    for r in range(TASK_ROWS):
        k = TASK_OF_ROW[r]
        rise = psi[level, k] - (psi[level - 1, k] if level > 0 else 0.0)
        if abs(rise) <= HANDLED:
            continue
        a = count
        while a > 0 and share[a - 1] < psi[level, k]:
            order[a], weight[a] = order[a - 1], weight[a - 1]
            share[a] = share[a - 1]
            a -= 1
        order[a], weight[a], share[a] = r, rise, psi[level, k]
        count += 1
    return count


@jit
def _solve_limited(
    factor: np.ndarray,
    gradient: np.ndarray,
    rows: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    x: np.ndarray,
    iterations: int,
) -> bool:
    """The level's QP as a least-distance problem in y = L' x + L^-1 g."""
    shift = gradient.copy()
    solve_lower(factor, shift, N)
    for i in range(LIMIT_ROWS):
        solve_lower(factor, rows[i], N)
        moved = 0.0
        for j in range(N):
            moved += rows[i, j] * shift[j]
        low[i] += moved
        high[i] += moved
    if not solve_least_distance(rows, low, high, x, iterations):
        return False
    for j in range(N):
        x[j] -= shift[j]
    solve_upper(factor, x, N)
    return True


@jit
def _reduce(
    projector: np.ndarray,
    projected: np.ndarray,
    share: np.ndarray,
    count: int,
    basis: np.ndarray,
    damping: float,
) -> None:
    """P (I - B' Lambda B) in place, by Gram-Schmidt on the rows of A P."""
    found = 0
    row = np.empty(N)
    for a in range(count):
        for j in range(N):
            row[j] = projected[a, j]
        for _ in range(2):  # once more, against cancellation
            for b in range(found):
                dot = 0.0
                for j in range(N):
                    dot += basis[b, j] * row[j]
                for j in range(N):
                    row[j] -= dot * basis[b, j]
        square = 0.0
        for j in range(N):
            square += row[j] * row[j]
        if square < _DEPENDENT:
            continue
        norm = np.sqrt(square)
        for j in range(N):
            basis[found, j] = row[j] / norm
        scale = share[a] * square / (square + damping)
        for i in range(N):
            dot = 0.0
            for j in range(N):
                dot += projector[i, j] * basis[found, j]
            for j in range(N):
                projector[i, j] -= scale * dot * basis[found, j]
        found += 1


@jit
def tick(
    state: RobotState,
    terms: ModelTerms,
    reference: Reference,
    robot: RobotLimits,
    gains: Gains,
    hierarchy: HierarchyConfig,
    limits: LimitConfig,
    priorities: np.ndarray,
    shares: np.ndarray,
    u: np.ndarray,
    torque: np.ndarray,
    counters: np.ndarray,
) -> bool:
    """One controller tick; False where a non-finite number came out.

    Args:
        state: The robot now.
        terms: The model at that state.
        reference: What the tasks follow.
        robot: Limits of the robot.
        gains: Of the tasks.
        hierarchy: Numbers of the recursion.
        limits: Shape of the limits.
        priorities: Priority matrices, shape (m, 4, 5); u is the mix of their solutions.
        shares: Weight of each matrix's solution, shape (m,).
        u: Result, shape (9,).
        torque: Result, shape (7,) [N m].
        counters: Levels, QPs and failures to add to, shape (3,).
    """
    jacobian = np.zeros((TASK_ROWS, N))
    target = np.zeros(TASK_ROWS)
    assemble_tasks(state, terms, reference, gains, jacobian, target)
    matrix = np.zeros((LIMIT_ROWS, N))
    lower, upper = np.zeros(LIMIT_ROWS), np.zeros(LIMIT_ROWS)
    assemble_limits(state, terms, robot, limits, matrix, lower, upper)
    part = np.empty(N)
    u[:] = 0.0
    for m in range(priorities.shape[0]):
        solve_hierarchy(
            jacobian,
            target,
            priorities[m],
            matrix,
            lower,
            upper,
            hierarchy,
            part,
            counters,
        )
        for j in range(N):
            u[j] += shares[m] * part[j]
    finite = True
    for i in range(7):
        value = terms.nonlinear[3 + i]
        for j in range(N):
            value += matrix[i, j] * u[j]
        torque[i] = _clip(value, -robot.torque[i], robot.torque[i])
        finite &= np.isfinite(value)
    for j in range(N):
        finite &= np.isfinite(u[j])
    return finite
