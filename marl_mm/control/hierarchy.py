"""Recursive hierarchical projection (Eq. 2, 3 of the paper), the readable form.

u_k = u_{k-1} + P_{k-1} x_k, where x_k minimises, within the limits,

    sum_t w_t |A_t (P x + u) - b_t|^2 + rho (|x|^2 - |P x|^2) + eps |x|^2,

w_t = psi(k, t) - psi(k-1, t). The weights go to zero where a task enters or leaves a
level and the rho term keeps a fractional projector from being undone by x: without
them alpha acts as a switch. For strict priorities both are the identity.
"""

from dataclasses import dataclass

import numpy as np

from marl_mm.control.config import DEPENDENT, HierarchyConfig
from marl_mm.control.limits import BOX_ROWS, Bounds
from marl_mm.control.priorities import handled_tasks
from marl_mm.control.proxqp import solve_qp
from marl_mm.control.tasks.task import VARIABLES, Task


@dataclass(frozen=True)
class Objective:
    """A level's cost x'Hx/2 + g'x."""

    hessian: np.ndarray
    """H, shape (9, 9), positive definite by the damping."""

    gradient: np.ndarray
    """g, shape (9,)."""


@dataclass(frozen=True)
class Solution:
    """What the hierarchy found."""

    acceleration: np.ndarray
    """u, shape (9,)."""

    levels: int
    """Levels solved."""

    qps: int
    """Levels whose closed form broke a limit."""

    failures: int
    """Levels whose QP found nothing, and which left u as it was."""


def solve_hierarchy(
    tasks: list[Task], psi: np.ndarray, limits: Bounds, config: HierarchyConfig
) -> Solution:
    """Solve all levels of a priority matrix, strict or fractional.

    Args:
        tasks: In the order of the matrix's columns.
        psi: Priority matrix, shape (levels, tasks).
        limits: On the whole of u, in every level.
        config: Damping and tolerances.
    """
    u, projector = np.zeros(VARIABLES), np.eye(VARIABLES)
    levels = qps = failures = 0
    for level in range(len(psi)):
        handled = handled_tasks(psi, level)
        if not handled:
            continue
        levels += 1
        above = psi[level - 1] if level else np.zeros(len(tasks))
        rho = config.rho if level else 0.0
        weights = psi[level] - above
        objective = level_objective(tasks, handled, weights, projector, u, rho, config)
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
            failures += found is None
            x = _rest(limits, level) if found is None else found
        u = u + projector @ x
        projector = next_projector(tasks, handled, psi[level], projector, config)
    return Solution(u, levels, qps, failures)


def level_objective(
    tasks: list[Task],
    handled: list[int],
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
    for k in handled:
        projected = tasks[k].jacobian @ projector
        residual = tasks[k].target - tasks[k].jacobian @ u
        hessian += weights[k] * projected.T @ projected
        gradient -= weights[k] * projected.T @ residual
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
    """P (I - B' Lambda B): B orthonormal rows of A P, Lambda their tasks' psi."""
    basis: list[np.ndarray] = []
    reduced = projector.copy()
    for k in handled:
        for row in tasks[k].jacobian @ projector:
            for _ in range(2):  # once more, against cancellation
                for known in basis:
                    row = row - (known @ row) * known
            square = row @ row
            if square < DEPENDENT:
                continue
            unit = row / np.sqrt(square)
            basis.append(unit)
            share = psi[k] * square / (square + config.projector_damping)
            reduced = reduced - share * np.outer(reduced @ unit, unit)
    return reduced


def _inside(room: Bounds, x: np.ndarray, tolerance: float) -> bool:
    value = room.matrix @ x
    above = (value > room.upper + tolerance).any()
    below = (value < room.lower - tolerance).any()
    return not (above or below)


def _rest(limits: Bounds, level: int) -> np.ndarray:
    """What a failed level adds: nothing, or at the first level zero inside the box."""
    zero = np.zeros(VARIABLES)
    if level:
        return zero
    return np.clip(zero, limits.lower[BOX_ROWS], limits.upper[BOX_ROWS])
