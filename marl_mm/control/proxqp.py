"""The reference QP solver: ProxSuite's dense ProxQP, with capped iterations."""

import numpy as np
from proxsuite import proxqp

_ACCURACY = 1e-12
"""Absolute. At 1e-9 a level's error of 1e-9 in a limit grows to 1e-2 in the next one's
solution, because a projected limit row can be a thousand times shorter."""

_ITERATIONS = 300
"""Outer and inner; about a millisecond where a problem is infeasible."""


def solve_qp(
    hessian: np.ndarray,
    gradient: np.ndarray,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> np.ndarray | None:
    """Minimise x'Hx/2 + g'x subject to lower <= matrix x <= upper.

    Returns:
        The minimiser, or None where the solver did not converge: uncapped, an
        infeasible problem of this size has run for a minute.
    """
    rows, size = matrix.shape
    problem = proxqp.dense.QP(size, 0, rows)
    problem.settings.eps_abs = _ACCURACY
    problem.settings.eps_rel = 0.0
    problem.settings.max_iter = _ITERATIONS
    problem.settings.max_iter_in = _ITERATIONS
    problem.init(hessian, gradient, None, None, matrix, lower, upper)
    problem.solve()
    if problem.results.info.status != proxqp.PROXQP_SOLVED:
        return None
    return np.array(problem.results.x)
