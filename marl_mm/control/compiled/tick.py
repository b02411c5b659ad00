"""One controller tick, compiled."""

from typing import Any

import numpy as np

from marl_mm.control.compiled.assembly import (
    TASK_ROWS,
    assemble_limits,
    assemble_tasks,
    clip,
)
from marl_mm.control.compiled.hierarchy import CAUSE, solve_hierarchy
from marl_mm.control.config import BRAKING_RATE, Gains, HierarchyConfig, LimitConfig
from marl_mm.control.limits import BOX, WHEEL_ARM, ZMP_ROWS
from marl_mm.control.records import VARIABLES as N
from marl_mm.control.records import Reference
from marl_mm.jit import jit, on_stack
from marl_mm.robot.description import WHEEL_RADIUS
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ModelTerms, RobotState

_MOST = ZMP_ROWS.stop
_task_rows, _task_row = on_stack(TASK_ROWS, N), on_stack(TASK_ROWS)
_limit_rows, _limit_row = on_stack(_MOST, N), on_stack(_MOST)
_variables = on_stack(N)


@jit
def tick(
    state: tuple[Any, ...],
    terms: tuple[Any, ...],
    reference: tuple[Any, ...],
    robot: tuple[Any, ...],
    gains: tuple[Any, ...],
    hierarchy: tuple[Any, ...],
    limits: tuple[Any, ...],
    priorities: np.ndarray,
    shares: np.ndarray,
    rows: int,
    rate: float,
    u: np.ndarray,
    torque: np.ndarray,
    counters: np.ndarray,
) -> tuple[bool, bool, float, float]:
    """One controller tick.

    The records come as plain tuples, because numba takes 0.6 us to recognise each
    named one.

    Args:
        state: ``RobotState``.
        terms: ``ModelTerms``.
        reference: ``Reference``.
        robot: ``RobotLimits``.
        gains: ``Gains``.
        hierarchy: ``HierarchyConfig``.
        limits: ``LimitConfig``.
        priorities: Priority matrices, shape (m, 4, 5); u is the mix of their solutions.
        shares: Weight of each matrix's solution, shape (m,).
        rows: Number of rows of the limits.
        rate: Ticks per second.
        u: Resulting acceleration, shape (9,).
        torque: Resulting torques of the arm joints, shape (7,) [N m].
        counters: Numbers of levels, QPs and failures, to which it adds, and the cause
            of the last failure, shape (4,).

    Returns:
        Whether the limits could be met (else u brakes), whether u is finite, and the
        base's speeds after the tick: forward [m/s], yaw rate [rad/s].
    """
    state_, terms_ = RobotState(*state), ModelTerms(*terms)
    robot_ = RobotLimits(*robot)
    jacobian, target = _task_rows(), _task_row()
    jacobian[:] = 0.0
    assemble_tasks(
        state_, terms_, Reference(*reference), Gains(*gains), jacobian, target
    )
    matrix, lower, upper = (
        _limit_rows()[:rows],
        _limit_row()[:rows],
        _limit_row()[:rows],
    )
    matrix[:] = 0.0
    assemble_limits(state_, terms_, robot_, LimitConfig(*limits), matrix, lower, upper)
    part = _variables()
    u[:] = 0.0
    feasible = True
    for m in range(priorities.shape[0]):
        feasible &= solve_hierarchy(
            jacobian,
            target,
            priorities[m],
            matrix,
            lower,
            upper,
            HierarchyConfig(*hierarchy),
            part,
            counters,
        )
        for j in range(N):
            u[j] += shares[m] * part[j]
    if not feasible:
        for j in range(N):
            velocity = state_.v[0 if j == 0 else j + 1]
            u[j] = clip(-BRAKING_RATE * velocity, lower[BOX + j], upper[BOX + j])
        share = 1.0
        for i in range(BOX):
            value = 0.0
            for j in range(N):
                value += matrix[i, j] * u[j]
            room = upper[i] if value > 0 else lower[i]
            if room * value > 0:
                share = min(share, room / value)
        for j in range(N):
            u[j] *= share
        worst = 0.0
        for i in range(rows):
            norm = value = 0.0
            for j in range(N):
                norm += matrix[i, j] * matrix[i, j]
                value += matrix[i, j] * u[j]
            excess = max(lower[i] - value, value - upper[i])
            if excess > worst * np.sqrt(norm):
                worst, counters[CAUSE] = excess / np.sqrt(norm), i
    finite = True
    for i in range(7):
        value = terms_.nonlinear[3 + i]
        for j in range(N):
            value += matrix[i, j] * u[j]
        torque[i] = clip(value, -robot_.torque[i], robot_.torque[i])
        finite &= np.isfinite(value)
    for j in range(N):
        finite &= np.isfinite(u[j])
    forward = clip(state_.v[0] + u[0] / rate, -robot_.speed[0], robot_.speed[0])
    most = (robot_.wheel_speed * WHEEL_RADIUS - abs(forward)) / WHEEL_ARM
    most = min(most, robot_.speed[1])
    yaw_rate = clip(state_.v[2] + u[1] / rate, -most, most)
    return feasible, finite, forward, yaw_rate
