"""One controller tick, compiled."""

import numpy as np

from marl_mm.control.compiled.assembly import (
    TASK_ROWS,
    assemble_limits,
    assemble_tasks,
    clip,
)
from marl_mm.control.compiled.hierarchy import solve_hierarchy
from marl_mm.control.compiled.jit import jit
from marl_mm.control.config import Gains, HierarchyConfig, LimitConfig
from marl_mm.control.limits import ROWS as LIMIT_ROWS
from marl_mm.control.tasks.task import VARIABLES as N
from marl_mm.control.tasks.task import Reference
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ModelTerms, RobotState


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
        torque[i] = clip(value, -robot.torque[i], robot.torque[i])
        finite &= np.isfinite(value)
    for j in range(N):
        finite &= np.isfinite(u[j])
    return finite
