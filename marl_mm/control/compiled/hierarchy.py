"""All levels of a priority matrix, compiled: reference/hierarchy.py has the idea.

Innermost loops run along rows, so that they are vectorised, and skip the zeros of rows
that select one variable.
"""

import numpy as np

from marl_mm.control.compiled.active_set import (
    SOLVED,
    cholesky,
    solve_least_distance,
    solve_lower,
    solve_upper,
)
from marl_mm.control.compiled.assembly import TASK_ROWS
from marl_mm.control.config import HierarchyConfig
from marl_mm.control.limits import BOX
from marl_mm.control.priorities import HANDLED
from marl_mm.control.records import VARIABLES as N
from marl_mm.jit import jit

TASK_OF_ROW = np.array([0, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4])
"""Column of the priority matrix that each task row belongs to."""

LEVELS, QPS, FAILURES, CAUSE = range(4)
"""Entries of the counters; CAUSE is the last failed level's code, see active_set."""


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
) -> bool:
    """All levels of a priority matrix; writes u (9,) and adds to the counters (4,).

    Returns:
        False where the limits contradict each other: the first level found nothing.
    """
    limits = len(lower)
    u[:] = 0.0
    projector = np.eye(N)
    row = np.empty(N)
    hessian = np.empty((N, N))
    factor = np.empty((N, N))
    gradient = np.empty(N)
    x = np.empty(N)
    step = np.empty(N)
    rows = np.empty((limits, N))
    low = np.empty(limits)
    high = np.empty(limits)
    order = np.empty(TASK_ROWS, np.int64)
    share = np.empty(TASK_ROWS)
    for level in range(psi.shape[0]):
        count = _handled_rows(psi, level, order, share)
        if count == 0:
            continue
        counters[LEVELS] += 1
        hessian[:] = 0.0
        gradient[:] = 0.0
        for r in range(TASK_ROWS):
            weight = _weight(psi, level, TASK_OF_ROW[r], config)
            if weight == 0.0:
                continue
            _times(jacobian, r, projector, row)
            residual = target[r]
            for k in range(N):
                residual -= jacobian[r, k] * u[k]
            for i in range(N):
                scaled = weight * row[i]
                gradient[i] -= residual * scaled
                for j in range(N):
                    hessian[i, j] += scaled * row[j]
        for i in range(N):
            hessian[i, i] += config.damping
        if level > 0:
            for k in range(N):
                hessian[k, k] += config.rho
                for i in range(N):
                    scaled = config.rho * projector[k, i]
                    for j in range(N):
                        hessian[i, j] -= scaled * projector[k, j]
        cholesky(hessian, factor, N)
        for j in range(N):
            x[j] = -gradient[j]
        solve_lower(factor, x, N)
        solve_upper(factor, x, N)

        _times_column(projector, x, step)
        broken = False
        for i in range(limits):
            if BOX <= i < BOX + N:
                used, value = u[i - BOX], step[i - BOX]
            else:
                used = value = 0.0
                for j in range(N):
                    used += matrix[i, j] * u[j]
                    value += matrix[i, j] * step[j]
            low[i], high[i] = lower[i] - used, upper[i] - used
            if level > 0:
                low[i] = min(low[i], 0.0) - config.margin
                high[i] = max(high[i], 0.0) + config.margin
            broken |= value > high[i] + config.tolerance
            broken |= value < low[i] - config.tolerance
        if broken:
            counters[QPS] += 1
            for i in range(limits):
                _times(matrix, i, projector, row)
                for j in range(N):
                    rows[i, j] = row[j]
            code = _solve_limited(
                factor, gradient, rows, low, high, x, config.iterations
            )
            if code != SOLVED:
                counters[FAILURES] += 1
                counters[CAUSE] = code
                if level == 0:
                    return False
                x[:] = 0.0
            _times_column(projector, x, step)
        for i in range(N):
            u[i] += step[i]
        if level < psi.shape[0] - 1:
            for a in range(count):
                _times(jacobian, order[a], projector, row)
                _deflate(projector, row, share[a], config.projector_damping)
    return True


@jit
def _times(
    matrix: np.ndarray, row: int, projector: np.ndarray, result: np.ndarray
) -> None:
    """A row of a matrix times the projector."""
    for j in range(N):
        result[j] = 0.0
    for k in range(N):
        factor = matrix[row, k]
        if factor != 0.0:
            for j in range(N):
                result[j] += factor * projector[k, j]


@jit
def _times_column(projector: np.ndarray, x: np.ndarray, result: np.ndarray) -> None:
    """The projector times a column."""
    for i in range(N):
        value = 0.0
        for j in range(N):
            value += projector[i, j] * x[j]
        result[i] = value


@jit
def _handled_rows(
    psi: np.ndarray, level: int, order: np.ndarray, share: np.ndarray
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
            order[a], share[a] = order[a - 1], share[a - 1]
            a -= 1
        order[a], share[a] = r, psi[level, k]
        count += 1
    return count


@jit
def _weight(psi: np.ndarray, level: int, task: int, config: HierarchyConfig) -> float:
    above = psi[level - 1, task] if level > 0 else 0.0
    if not config.weighted:
        return 1.0 if psi[level, task] > above else 0.0
    protected = config.protection * above * (1.0 - above)
    weight: float = psi[level, task] - above + protected
    return weight


@jit
def _solve_limited(
    factor: np.ndarray,
    gradient: np.ndarray,
    rows: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    x: np.ndarray,
    iterations: int,
) -> int:
    """The level's QP as a least-distance problem in y = L' x + L^-1 g."""
    limits = len(low)
    shift = gradient.copy()
    solve_lower(factor, shift, N)
    columns = np.empty((N, limits))  # of rows L'^-1
    for i in range(N):
        for r in range(limits):
            columns[i, r] = rows[r, i]
        for k in range(i):
            for r in range(limits):
                columns[i, r] -= factor[i, k] * columns[k, r]
        for r in range(limits):
            columns[i, r] /= factor[i, i]
            low[r] += columns[i, r] * shift[i]
            high[r] += columns[i, r] * shift[i]
    code = solve_least_distance(columns, low, high, x, iterations)
    for j in range(N):
        x[j] -= shift[j]
    solve_upper(factor, x, N)
    return code


@jit
def _deflate(
    projector: np.ndarray, row: np.ndarray, share: float, damping: float
) -> None:
    """P (I - share a a' / (a'a + damping)) in place."""
    square = damping
    for j in range(N):
        square += row[j] * row[j]
    for i in range(N):
        dot = 0.0
        for j in range(N):
            dot += projector[i, j] * row[j]
        dot *= share / square
        for j in range(N):
            projector[i, j] -= dot * row[j]
