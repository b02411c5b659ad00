"""Least-distance QP by the dual active-set method of Goldfarb & Idnani, compiled.

Minimise |y|^2 / 2 subject to lower <= M y <= upper. Start at y = 0, the unconstrained
minimum. Take the most violated row p with inward normal n: its projection z off the
active normals says how y can move, r = (their least-squares coefficients of n) how
their multipliers give way. Step until p is met, or until a multiplier reaches zero and
its row leaves; where z = 0 only multipliers move. (Goldfarb & Idnani 1983; the active
normals are kept as Q R, grown by Gram-Schmidt at each addition.)

Rows are passed as columns: loops over all rows then run over neighbouring memory.
"""

import numpy as np
from numba import types

from marl_mm.control.limits import ZMP_ROWS
from marl_mm.control.records import VARIABLES as N
from marl_mm.jit import jit, on_stack

_VIOLATED = 1e-10
"""Violation above which a row joins the active set."""

_VANISHING = 1e-12
"""Least squared norm by which distances are measured."""

_DEPENDENT = 1e-18
"""Squared share of a normal left by projection, below which it counts as dependent."""

SOLVED = -1
"""Return value with the minimiser found."""

EXHAUSTED = -2
"""Return value at the iteration limit."""

_vector, _square, _bounds = on_stack(N), on_stack(N, N), on_stack(ZMP_ROWS.stop)
_numbers = on_stack(N, number=types.int64)


@jit
def cholesky(upper: np.ndarray) -> None:
    """Factor L of a positive definite matrix A, and L^-1 b, in place.

    Tiny pivots are raised.

    Args:
        upper: A's upper triangle and b as a last column, shape (9, 10); L' and
            L^-1 b afterwards.
    """
    for j in range(N):
        pivot = upper[j, j]
        for k in range(j):
            pivot -= upper[k, j] * upper[k, j]
        pivot = np.sqrt(max(pivot, 1e-14))
        upper[j, j] = pivot
        for i in range(j + 1, N + 1):
            value = upper[j, i]
            for k in range(j):
                value -= upper[k, i] * upper[k, j]
            upper[j, i] = value / pivot


@jit
def solve_upper(upper: np.ndarray, vector: np.ndarray) -> None:
    """L' x = b in place, given ``cholesky``'s L'."""
    for i in range(N - 1, -1, -1):
        value = vector[i]
        for k in range(i + 1, N):
            value -= upper[i, k] * vector[k]
        vector[i] = value / upper[i, i]


@jit
def solve_least_distance(
    columns: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    y: np.ndarray,
    iterations: int,
) -> int:
    """Write the minimiser into ``y``.

    Args:
        columns: Rows of the limits as columns, M', shape (n, m or more), n <= 9.
        lower: Lower bounds, shape (m,), m <= 28.
        upper: Upper bounds, shape (m,).
        y: Resulting minimiser, shape (n,).
        iterations: Limit of steps, each of which adds or drops a row.

    Returns:
        SOLVED, EXHAUSTED, or the row that contradicts those met before it.
    """
    n, m = len(columns), len(lower)
    active = _numbers()
    multiplier, normal, change = _vector(), _vector(), _vector()
    shares, move = _vector(), _vector()
    normal[:] = 0.0  # beyond n, too
    normals = _square()  # of the active rows, inward: N' = Q R
    basis, triangle = _square(), _square()  # rows of Q', and R
    value, scale = _bounds()[:m], _bounds()[:m]
    value[:] = scale[:] = 0.0
    for j in range(n):
        for i in range(m):
            scale[i] += columns[j, i] * columns[j, i]
    for i in range(m):
        scale[i] = 1.0 / np.sqrt(max(scale[i], _VANISHING))
    count = 0
    y[:] = 0.0
    entering, sign, entering_multiplier = -1, 0.0, 0.0
    for _ in range(iterations):
        if entering < 0:
            entering, sign = _most_violated(value, lower, upper, scale, active, count)
            entering_multiplier = 0.0
            if entering < 0:
                return SOLVED
        size = slack = 0.0
        for j in range(n):
            normal[j] = sign * columns[j, entering]
            size += normal[j] * normal[j]
            slack += normal[j] * y[j]
        left = _project(normal, basis, count, move, shares)
        for a in range(count - 1, -1, -1):  # R change = shares
            value_a = shares[a]
            for b in range(a + 1, count):
                value_a -= triangle[a, b] * change[b]
            change[a] = value_a / triangle[a, a]
        bound = lower[entering] if sign > 0 else -upper[entering]
        full = np.inf
        if left > _DEPENDENT * size:
            full = max((bound - slack) / left, 0.0)
        partial, leaving = np.inf, -1
        for a in range(count):
            if change[a] > 1e-14 and multiplier[a] / change[a] < partial:
                partial, leaving = multiplier[a] / change[a], a
        step = min(full, partial)
        if step == np.inf:
            return entering
        for a in range(count):
            multiplier[a] = max(multiplier[a] - step * change[a], 0.0)
        entering_multiplier += step
        if full < np.inf:
            for j in range(n):
                y[j] += step * move[j]
            _rows_times(columns, y, value)
        if full <= partial:
            if count == n:
                return entering
            active[count], multiplier[count] = entering, entering_multiplier
            _append(normal, left, move, shares, count, normals, basis, triangle)
            count += 1
            entering = -1
        else:
            count -= 1
            for a in range(leaving, count):
                active[a], multiplier[a] = active[a + 1], multiplier[a + 1]
                for j in range(n):
                    normals[a, j] = normals[a + 1, j]
            for a in range(leaving, count):
                left = _project(normals[a], basis, a, move, shares)
                _append(normals[a], left, move, shares, a, normals, basis, triangle)
    return EXHAUSTED


@jit
def _rows_times(columns: np.ndarray, y: np.ndarray, value: np.ndarray) -> None:
    """M y for all rows."""
    value[:] = 0.0
    for j in range(len(y)):
        for i in range(len(value)):
            value[i] += columns[j, i] * y[j]


@jit
def _most_violated(
    value: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    scale: np.ndarray,
    active: np.ndarray,
    count: int,
) -> tuple[int, float]:
    """The inactive row furthest from y and the side it is on, or -1."""
    worst, found, sign = _VIOLATED, -1, 0.0
    for i in range(len(value)):
        below = (lower[i] - value[i]) * scale[i]
        above = (value[i] - upper[i]) * scale[i]
        if below <= worst and above <= worst:
            continue
        is_active = False
        for a in range(count):
            is_active |= active[a] == i
        if is_active:
            continue
        if below > worst:
            worst, found, sign = below, i, 1.0
        if above > worst:
            worst, found, sign = above, i, -1.0
    return found, sign


@jit
def _project(
    normal: np.ndarray,
    basis: np.ndarray,
    count: int,
    rest: np.ndarray,
    shares: np.ndarray,
) -> float:
    """Split a normal into its shares of the basis and a rest; the rest's square.

    Once more where little is left, against cancellation: with a Gram matrix in place of
    the basis, half of the digits would be lost.
    """
    n = len(normal)
    square = 0.0
    for j in range(n):
        rest[j] = normal[j]
        square += normal[j] * normal[j]
    for a in range(count):
        shares[a] = 0.0
    for _ in range(3):
        before, square = square, 0.0
        for a in range(count):
            dot = 0.0
            for j in range(n):
                dot += basis[a, j] * rest[j]
            for j in range(n):
                rest[j] -= dot * basis[a, j]
            shares[a] += dot
        for j in range(n):
            square += rest[j] * rest[j]
        if square > 0.1 * before:
            break
    return square


@jit
def _append(
    normal: np.ndarray,
    left: float,
    rest: np.ndarray,
    shares: np.ndarray,
    count: int,
    normals: np.ndarray,
    basis: np.ndarray,
    triangle: np.ndarray,
) -> None:
    """Let a normal, split by ``_project``, be the next active one."""
    norm = np.sqrt(left)
    for j in range(len(normal)):
        normals[count, j] = normal[j]
        basis[count, j] = rest[j] / norm
    for a in range(count):
        triangle[a, count] = shares[a]
    triangle[count, count] = norm
