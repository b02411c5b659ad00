"""QP solvers of the readable form: ProxSuite's dense ProxQP, and DAQP.

Both minimise x'Hx/2 + g'x subject to lower <= C x <= upper, and return the minimiser
or, where there is none, the row of C that stood in the way.
"""

import sys
from collections.abc import Callable

import numpy as np

# ProxSuite's AVX builds round differently as malloc puts the LDLT factor at odd or even
# multiples of 16 bytes: equal problems differed by 1e-14 from run to run. The plain
# build does not, and costs the same at this size. None makes the import of a build
# fail, upon which the package takes the next one.
for _build in ("avx512", "avx2"):
    sys.modules.setdefault(f"proxsuite.proxsuite_pywrap_{_build}", None)  # type: ignore[arg-type]

from proxsuite import proxqp as proxsuite_qp  # noqa: E402

_ACCURACY = 1e-12
"""Absolute accuracy. At 1e-9 a level's error of 1e-9 in a limit grows to 1e-2 in the
next one's solution, because a projected limit row can be a thousand times shorter."""

_ITERATIONS = 200
"""Limit of outer and inner iterations: ProxQP does not detect infeasible problems."""

NO_CAUSE = -1
"""Cause where no level failed."""

SolveQp = Callable[
    [np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray | int
]
"""(H, g, C, lower, upper) to x, shape (n,), or to a row of C."""


def proxqp(
    hessian: np.ndarray,
    gradient: np.ndarray,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> np.ndarray | int:
    """Solve by ProxQP, with capped iterations.

    Uncapped, an infeasible problem of this size has run for a minute.
    """
    rows, size = matrix.shape
    problem = proxsuite_qp.dense.QP(size, 0, rows)
    problem.settings.eps_abs = _ACCURACY
    problem.settings.eps_rel = 0.0
    problem.settings.max_iter = _ITERATIONS
    problem.settings.max_iter_in = _ITERATIONS
    problem.init(hessian, gradient, None, None, matrix, lower, upper)
    problem.solve()
    x = np.array(problem.results.x)
    if problem.results.info.status != proxsuite_qp.PROXQP_SOLVED:
        return _worst_row(matrix @ x, lower, upper)
    return x


def daqp(
    hessian: np.ndarray,
    gradient: np.ndarray,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> np.ndarray | int:
    """Solve by DAQP, a dual active-set method in C."""
    import daqp as solver  # optional

    x, _, flag, _ = solver.solve(
        hessian,
        gradient,
        np.ascontiguousarray(matrix),
        upper,
        lower,
        np.zeros(len(lower), np.int32),
        primal_tol=1e-10,
    )
    if flag < 1:
        return _worst_row(matrix @ x, lower, upper)
    return np.array(x)


def _worst_row(value: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> int:
    """The row furthest outside, where the solver gave up."""
    return int(np.argmax(np.maximum(lower - value, value - upper)))
