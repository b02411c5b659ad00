"""Least-distance QP by the dual active-set method of Goldfarb & Idnani, compiled.

Minimise |y|^2 / 2 subject to lower <= M y <= upper. Start at y = 0, the unconstrained
minimum. Take the most violated row p with inward normal n: its projection z off the
active normals says how y can move, r = (their least-squares coefficients of n) how
their multipliers give way. Step until p is met, or until a multiplier reaches zero and
its row leaves; where z = 0 only multipliers move. (Goldfarb & Idnani 1983, with the
Gram matrix of at most nine active normals factored anew at each step.)
"""

import numpy as np

from marl_mm.control.compiled.jit import jit

_VIOLATED = 1e-9
"""A row outside by more than this, relative to its scale, joins the active set."""

_DEPENDENT = 1e-13
"""Squared share of a normal left by projection, below which it counts as dependent."""


@jit
def cholesky(matrix: np.ndarray, factor: np.ndarray, size: int) -> None:
    """Lower factor of a positive definite matrix; tiny pivots are raised."""
    for j in range(size):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= factor[j, k] * factor[j, k]
        pivot = np.sqrt(max(pivot, 1e-14))
        factor[j, j] = pivot
        for i in range(j + 1, size):
            value = matrix[i, j]
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            factor[i, j] = value / pivot


@jit
def solve_lower(factor: np.ndarray, vector: np.ndarray, size: int) -> None:
    """L x = b in place."""
    for i in range(size):
        value = vector[i]
        for k in range(i):
            value -= factor[i, k] * vector[k]
        vector[i] = value / factor[i, i]


@jit
def solve_upper(factor: np.ndarray, vector: np.ndarray, size: int) -> None:
    """L' x = b in place, given L."""
    for i in range(size - 1, -1, -1):
        value = vector[i]
        for k in range(i + 1, size):
            value -= factor[k, i] * vector[k]
        vector[i] = value / factor[i, i]


@jit
def solve_least_distance(
    rows: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    y: np.ndarray,
    iterations: int,
) -> bool:
    """Write the minimiser into ``y``; False where there is none or it was not found.

    Args:
        rows: M, shape (m, n).
        lower: Shape (m,).
        upper: Shape (m,).
        y: Result, shape (n,).
        iterations: Most steps, each of which adds or drops a row.
    """
    n = rows.shape[1]
    active = np.zeros(n, np.int64)
    side = np.zeros(n)  # +1 where the row is at its lower bound, -1 at its upper
    multiplier = np.zeros(n)
    factor = np.zeros((n, n))
    gram = np.zeros((n, n))
    change = np.zeros(n)
    move = np.zeros(n)
    count = 0
    y[:] = 0.0
    entering, sign, entering_multiplier = -1, 0.0, 0.0
    for _ in range(iterations):
        if entering < 0:
            entering, sign = _most_violated(rows, lower, upper, y, active, count)
            entering_multiplier = 0.0
            if entering < 0:
                return True
        normal = rows[entering]
        _factor_active(rows, active, side, count, gram, factor)
        for a in range(count):
            change[a] = 0.0
            for j in range(n):
                change[a] += side[a] * rows[active[a], j] * sign * normal[j]
        solve_lower(factor, change, count)
        solve_upper(factor, change, count)
        size = left = slack = 0.0
        for j in range(n):
            move[j] = sign * normal[j]
            for a in range(count):
                move[j] -= change[a] * side[a] * rows[active[a], j]
            size += normal[j] * normal[j]
            left += move[j] * move[j]
            slack += sign * normal[j] * y[j]
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
            return False  # the row contradicts the active ones
        for a in range(count):
            multiplier[a] = max(multiplier[a] - step * change[a], 0.0)
        entering_multiplier += step
        if full < np.inf:
            for j in range(n):
                y[j] += step * move[j]
        if full <= partial:
            if count == n:
                return False
            active[count], side[count] = entering, sign
            multiplier[count] = entering_multiplier
            count += 1
            entering = -1
        else:
            for a in range(leaving, count - 1):
                active[a], side[a] = active[a + 1], side[a + 1]
                multiplier[a] = multiplier[a + 1]
            count -= 1
    return False


@jit
def _most_violated(
    rows: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    y: np.ndarray,
    active: np.ndarray,
    count: int,
) -> tuple[int, float]:
    """The inactive row furthest outside and the side it is on, or -1."""
    worst, found, sign = 0.0, -1, 0.0
    for i in range(rows.shape[0]):
        is_active = False
        for a in range(count):
            is_active |= active[a] == i
        if is_active:
            continue
        value = 0.0
        for j in range(rows.shape[1]):
            value += rows[i, j] * y[j]
        below = (lower[i] - value) / (1.0 + abs(lower[i]))
        above = (value - upper[i]) / (1.0 + abs(upper[i]))
        if below > max(worst, _VIOLATED):
            worst, found, sign = below, i, 1.0
        if above > max(worst, _VIOLATED):
            worst, found, sign = above, i, -1.0
    return found, sign


@jit
def _factor_active(
    rows: np.ndarray,
    active: np.ndarray,
    side: np.ndarray,
    count: int,
    gram: np.ndarray,
    factor: np.ndarray,
) -> None:
    """Cholesky factor of the active normals' Gram matrix."""
    for a in range(count):
        for b in range(a + 1):
            dot = 0.0
            for j in range(rows.shape[1]):
                dot += rows[active[a], j] * rows[active[b], j]
            gram[a, b] = side[a] * side[b] * dot
    cholesky(gram, factor, count)
