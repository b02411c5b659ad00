"""All levels of a priority matrix, compiled: reference/hierarchy.py has the idea.

Loops over nine variables are unrolled, and the loops around them vectorised, for which
the projector is kept with its transpose; zeros of rows that select one variable are
skipped.
"""

import numpy as np
from numba import types

from marl_mm.control.compiled.active_set import (
    SOLVED,
    cholesky,
    solve_least_distance,
    solve_upper,
)
from marl_mm.control.compiled.assembly import TASK_ROWS
from marl_mm.control.config import HierarchyConfig
from marl_mm.control.limits import ZMP_ROWS
from marl_mm.control.priorities import HANDLED
from marl_mm.control.records import VARIABLES as N
from marl_mm.jit import jit, on_stack

TASK_OF_ROW = np.array([0, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4])
"""Column of the priority matrix that each task row belongs to."""

LEVELS, QPS, FAILURES, CAUSE = range(4)
"""Entries of the counters; CAUSE is the last failed level's code, see active_set."""

_ROWS = ZMP_ROWS.stop
_vector, _task_vector, _bounds = on_stack(N), on_stack(TASK_ROWS), on_stack(_ROWS)
_task_numbers = on_stack(TASK_ROWS, number=types.int64)
# Rows as long as whole cache lines, of which only the first columns are used.
_square, _augmented, _columns = on_stack(N, 16), on_stack(N, 16), on_stack(N, 32)


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
    projector, transposed, row = _square(), _square(), _vector()
    upper_hessian, gradient, x, step = _augmented(), _vector(), _vector(), _vector()
    columns, low, high = _columns(), _bounds(), _bounds()
    used, value = _bounds(), _bounds()
    order, share = _task_numbers(), _task_vector()
    for i in range(N):
        for j in range(N):
            projector[i, j] = transposed[i, j] = 1.0 if i == j else 0.0
        for r in range(limits):
            columns[i, r] = matrix[r, i]
    for level in range(psi.shape[0]):
        count = _handled_rows(psi, level, order, share)
        if count == 0:
            continue
        counters[LEVELS] += 1
        upper_hessian[:] = 0.0
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
                    upper_hessian[j, i] += scaled * row[j]
        for i in range(N):
            upper_hessian[i, i] += config.damping
        if level > 0:
            for k in range(N):
                upper_hessian[k, k] += config.rho
                for i in range(N):
                    scaled = config.rho * projector[k, i]
                    for j in range(N):
                        upper_hessian[j, i] -= scaled * projector[k, j]
        for i in range(N):
            upper_hessian[i, N] = -gradient[i]
        cholesky(upper_hessian)
        for i in range(N):
            x[i] = upper_hessian[i, N]
        solve_upper(upper_hessian, x)

        _times_column(transposed, x, step)
        for r in range(limits):
            used[r] = value[r] = 0.0
        for j in range(N):
            for r in range(limits):
                used[r] += columns[j, r] * u[j]
                value[r] += columns[j, r] * step[j]
        broken = False
        for i in range(limits):
            low[i], high[i] = lower[i] - used[i], upper[i] - used[i]
            if level > 0:
                low[i] = min(low[i], 0.0) - config.margin
                high[i] = max(high[i], 0.0) + config.margin
            broken |= value[i] > high[i] + config.tolerance
            broken |= value[i] < low[i] - config.tolerance
        if broken:
            counters[QPS] += 1
            code = _solve_limited(
                upper_hessian,
                matrix,
                projector,
                low[:limits],
                high[:limits],
                x,
                config.iterations,
            )
            if code != SOLVED:
                counters[FAILURES] += 1
                counters[CAUSE] = code
                if level == 0:
                    return False
                x[:] = 0.0
            _times_column(transposed, x, step)
        for i in range(N):
            u[i] += step[i]
        if level < psi.shape[0] - 1:
            for a in range(count):
                _times(jacobian, order[a], projector, row)
                _deflate(projector, transposed, row, share[a], config.projector_damping)
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
def _times_column(transposed: np.ndarray, x: np.ndarray, result: np.ndarray) -> None:
    """The projector, given its transpose, times a column."""
    for i in range(N):
        result[i] = 0.0
    for j in range(N):
        for i in range(N):
            result[i] += transposed[j, i] * x[j]


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
    upper: np.ndarray,
    matrix: np.ndarray,
    projector: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    x: np.ndarray,
    iterations: int,
) -> int:
    """The level's QP as a least-distance problem in y = L' x + L^-1 g.

    Args:
        upper: L' and -L^-1 g, see ``cholesky``.
        matrix: Rows of the limits on u, shape (m, 9).
        projector: Projector, from x to u.
        low: Lower bounds of the limits, shape (m,); those on y afterwards.
        high: Upper bounds of the limits, shape (m,); those on y afterwards.
        x: Resulting minimiser.
        iterations: See ``solve_least_distance``.

    Returns:
        See ``solve_least_distance``.
    """
    limits = len(low)
    row = _vector()
    columns = _columns()  # of the rows on x, times L'^-1
    for r in range(limits):
        _times(matrix, r, projector, row)
        for i in range(N):
            columns[i, r] = row[i]
    for i in range(N):
        for k in range(i):
            for r in range(limits):
                columns[i, r] -= upper[k, i] * columns[k, r]
        for r in range(limits):
            columns[i, r] /= upper[i, i]
            low[r] -= columns[i, r] * upper[i, N]
            high[r] -= columns[i, r] * upper[i, N]
    code = solve_least_distance(columns, low, high, x, iterations)
    for j in range(N):
        x[j] += upper[j, N]
    solve_upper(upper, x)
    return code


@jit
def _deflate(
    projector: np.ndarray,
    transposed: np.ndarray,
    row: np.ndarray,
    share: float,
    damping: float,
) -> None:
    """P (I - share a a' / (a'a + damping)) in place, and its transpose."""
    square, direction, column = damping, _vector(), _vector()
    for j in range(N):
        square += row[j] * row[j]
        direction[j] = row[j]
    _times_column(transposed, direction, column)
    for i in range(N):
        column[i] *= share / square
    for i in range(N):
        for j in range(N):
            projector[i, j] -= column[i] * direction[j]
    for i in range(N):
        for j in range(N):
            transposed[i, j] -= direction[i] * column[j]
