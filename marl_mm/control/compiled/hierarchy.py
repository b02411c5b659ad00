"""All levels of a priority matrix, compiled: see control/hierarchy.py for the idea."""

import numpy as np

from marl_mm.control.compiled.active_set import (
    cholesky,
    solve_least_distance,
    solve_lower,
    solve_upper,
)
from marl_mm.control.compiled.assembly import TASK_ROWS, clip
from marl_mm.control.compiled.jit import jit
from marl_mm.control.config import DEPENDENT, HierarchyConfig
from marl_mm.control.limits import ROWS as LIMIT_ROWS
from marl_mm.control.priorities import HANDLED
from marl_mm.control.tasks.task import VARIABLES as N

TASK_OF_ROW = np.array([0, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4])
"""Column of the priority matrix that each task row belongs to."""

LEVELS, QPS, FAILURES = range(3)
"""Entries of the counters."""


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
                    x[j] = 0.0 if level else clip(0.0, lower[7 + j], upper[7 + j])
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
        if square < DEPENDENT:
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
