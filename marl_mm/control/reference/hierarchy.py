"""Recursive hierarchical projection (Eq. 2, 3 of the paper), the readable form.

u_k = u_{k-1} + P_{k-1} x_k, where x_k minimises, within the limits,

    sum_t w_t |A_t (P x + u) - b_t|^2 + rho (|x|^2 - |P x|^2) + eps |x|^2,

w_t = psi(k, t) - psi(k-1, t) + protection psi(k-1, t) (1 - psi(k-1, t)).

The weights go to zero where a task enters or leaves a level; a task half served above
keeps a say, or else the next one would undo it through a projector that is only half
closed; and the rho term keeps x from undoing the projector as a whole. Without them
alpha acts as a switch. With strict priorities protection has no effect, and the rho
term acts as far as the projector's damping leaves a direction open.
"""

from dataclasses import dataclass

import numpy as np

from marl_mm.control.config import HierarchyConfig
from marl_mm.control.priorities import HANDLED
from marl_mm.control.records import VARIABLES
from marl_mm.control.reference.limits import Bounds
from marl_mm.control.reference.qp import NO_CAUSE, SolveQp, proxqp
from marl_mm.control.reference.tasks.task import Task


@dataclass(frozen=True)
class Objective:
    """A level's cost x'Hx/2 + g'x."""

    hessian: np.ndarray
    """Hessian H, shape (9, 9), positive definite by the damping."""

    gradient: np.ndarray
    """Gradient g at 0, shape (9,)."""


@dataclass(frozen=True)
class Solution:
    """Result of a hierarchy."""

    acceleration: np.ndarray
    """Acceleration u, shape (9,)."""

    levels: int
    """Number of levels solved."""

    qps: int
    """Number of levels whose closed form broke a limit."""

    failures: int
    """Number of levels whose QP failed, and which left u as it was."""

    cause: int
    """Row of the limits that made the last failed level infeasible, or NO_CAUSE."""

    feasible: bool
    """Whether the first level was feasible: else the limits contradict each other."""


def solve_hierarchy(
    tasks: list[Task],
    psi: np.ndarray,
    limits: Bounds,
    config: HierarchyConfig,
    solve_qp: SolveQp = proxqp,
) -> Solution:
    """Solve all levels of a priority matrix, strict or fractional.

    Args:
        tasks: Tasks in the order of the matrix's columns.
        psi: Priority matrix, shape (levels, tasks).
        limits: Limits on the whole of u, in every level.
        config: Damping and tolerances.
        solve_qp: Solver of the levels whose closed form breaks a limit.
    """
    u, projector = np.zeros(VARIABLES), np.eye(VARIABLES)
    levels = qps = failures = 0
    cause, feasible = NO_CAUSE, True
    for level in range(len(psi)):
        handled = handled_tasks(psi, level)
        if not handled:
            continue
        levels += 1
        above = psi[level - 1] if level else np.zeros(len(tasks))
        rho = config.rho if level else 0.0
        weights = psi[level] - above + config.protection * above * (1 - above)
        if not config.weighted:
            weights = (psi[level] > above).astype(float)
        objective = level_objective(tasks, weights, projector, u, rho, config)
        room = level_bounds(limits, projector, u, config.margin if level else None)
        x = -np.linalg.solve(objective.hessian, objective.gradient)
        if not _inside(room, x, config.tolerance):
            qps += 1
            found = solve_qp(
                objective.hessian,
                objective.gradient,
                room.matrix,
                room.lower,
                room.upper,
            )
            if isinstance(found, int):
                failures, cause = failures + 1, found
                if level == 0:
                    feasible = False
                    break
                x = np.zeros(VARIABLES)
            else:
                x = found
        u = u + projector @ x
        projector = next_projector(tasks, handled, psi[level], projector, config)
    return Solution(u, levels, qps, failures, cause, feasible)


def handled_tasks(psi: np.ndarray, level: int) -> list[int]:
    """Tasks whose psi rises at a level, highest psi first; ties in Table 1's order."""
    above = psi[level - 1] if level else np.zeros(psi.shape[1])
    risen = [k for k in range(psi.shape[1]) if abs(psi[level, k] - above[k]) > HANDLED]
    return sorted(risen, key=lambda k: -psi[level, k])


def level_objective(
    tasks: list[Task],
    weights: np.ndarray,
    projector: np.ndarray,
    u: np.ndarray,
    rho: float,
    config: HierarchyConfig,
) -> Objective:
    """A level's damped least squares in x."""
    identity = np.eye(VARIABLES)
    hessian = config.damping * identity + rho * (identity - projector.T @ projector)
    gradient = np.zeros(VARIABLES)
    for task, weight in zip(tasks, weights, strict=True):
        projected = task.jacobian @ projector
        residual = task.target - task.jacobian @ u
        hessian += weight * projected.T @ projected
        gradient -= weight * projected.T @ residual
    return Objective(hessian, gradient)


def level_bounds(
    limits: Bounds, projector: np.ndarray, u: np.ndarray, margin: float | None
) -> Bounds:
    """The limits on u + P x as limits on x; a margin makes x = 0 lie inside."""
    used = limits.matrix @ u
    lower, upper = limits.lower - used, limits.upper - used
    if margin is not None:
        lower = np.minimum(lower, 0.0) - margin
        upper = np.maximum(upper, 0.0) + margin
    return Bounds(limits.matrix @ projector, lower, upper)


def next_projector(
    tasks: list[Task],
    handled: list[int],
    psi: np.ndarray,
    projector: np.ndarray,
    config: HierarchyConfig,
) -> np.ndarray:
    """P times I - psi a a' / (a'a + damping) for each row a of A P, one by one.

    Each row is taken through the projector as it stands then: at psi 1 this is
    Gram-Schmidt, and P the null space's projector; at less, no row takes a direction
    away from those after it that it did not close itself.
    """
    for k in handled:
        for row in tasks[k].jacobian:
            a = row @ projector
            share = psi[k] / (a @ a + config.projector_damping)
            projector = projector - share * np.outer(projector @ a, a)
    return projector


def _inside(room: Bounds, x: np.ndarray, tolerance: float) -> bool:
    value = room.matrix @ x
    above = (value > room.upper + tolerance).any()
    below = (value < room.lower - tolerance).any()
    return not (above or below)
