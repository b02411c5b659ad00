"""Least-distance QP by a dual active-set method, compiled.

Minimise |y|^2 / 2 subject to lower <= M y <= upper. Start at y = 0, the unconstrained
minimum; add the most violated row, solve the small equality system of the active rows
for their multipliers, and drop rows whose multiplier gets the wrong sign (Goldfarb &
Idnani 1983, without their factorisation updates: at most nine rows are active).
"""

import numpy as np
from numba import njit

_VIOLATED = 1e-7
"""A row outside by more than this joins the active set."""

_LOST = 1e-4
"""An active row still outside by this much means dependent rows: give up."""

_REGULARISED = 1e-10
"""Relative weight on the diagonal of the active rows' Gram matrix."""


@njit(cache=True)
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


@njit(cache=True)
def solve_lower(factor: np.ndarray, vector: np.ndarray, size: int) -> None:
    """L x = b in place."""
    for i in range(size):
        value = vector[i]
        for k in range(i):
            value -= factor[i, k] * vector[k]
        vector[i] = value / factor[i, i]


@njit(cache=True)
def solve_upper(factor: np.ndarray, vector: np.ndarray, size: int) -> None:
    """L' x = b in place, given L."""
    for i in range(size - 1, -1, -1):
        value = vector[i]
        for k in range(i + 1, size):
            value -= factor[k, i] * vector[k]
        vector[i] = value / factor[i, i]


@njit(cache=True)
def solve_least_distance(
    rows: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    y: np.ndarray,
    iterations: int,
) -> bool:
    """Write the minimiser into ``y``; False where none was found.

    Args:
        rows: M, shape (m, n).
        lower: Shape (m,).
        upper: Shape (m,).
        y: Result, shape (n,).
        iterations: Most rounds of adding and dropping rows.
    """
    m, n = rows.shape
    most = n + 1
    active = np.zeros(most, np.int64)
    at_upper = np.zeros(most, np.bool_)
    multiplier = np.zeros(most)
    wanted = np.zeros(most)
    gram = np.zeros((most, most))
    factor = np.zeros((most, most))
    count = 0
    y[:] = 0.0
    for _ in range(iterations):
        for a in range(count):
            i = active[a]
            wanted[a] = upper[i] if at_upper[a] else lower[i]
            for b in range(a + 1):
                dot = 0.0
                for j in range(n):
                    dot += rows[i, j] * rows[active[b], j]
                gram[a, b] = dot
            gram[a, a] += _REGULARISED * (1 + gram[a, a])
        cholesky(gram, factor, count)
        solve_lower(factor, wanted, count)
        solve_upper(factor, wanted, count)
        step, blocking = 2.0, -1
        for a in range(count):
            wrong = wanted[a] > 1e-12 if at_upper[a] else wanted[a] < -1e-12
            if wrong:
                change = multiplier[a] - wanted[a]
                ratio = multiplier[a] / change if change != 0.0 else 0.0
                if ratio < step:
                    step, blocking = ratio, a
        if blocking >= 0:
            for a in range(count):
                multiplier[a] += step * (wanted[a] - multiplier[a])
            for a in range(blocking, count - 1):
                active[a] = active[a + 1]
                at_upper[a] = at_upper[a + 1]
                multiplier[a] = multiplier[a + 1]
            count -= 1
            continue
        for j in range(n):
            y[j] = 0.0
        for a in range(count):
            multiplier[a] = wanted[a]
            for j in range(n):
                y[j] += rows[active[a], j] * wanted[a]
        worst, row, upward = _VIOLATED, -1, False
        for i in range(m):
            value = 0.0
            for j in range(n):
                value += rows[i, j] * y[j]
            above, below = value - upper[i], lower[i] - value
            is_active = False
            for a in range(count):
                is_active |= active[a] == i
            if is_active:
                if max(above, below) > _LOST:
                    return False
            elif above > worst:
                worst, row, upward = above, i, True
            elif below > worst:
                worst, row, upward = below, i, False
        if row < 0:
            return True
        if count == most:
            return False
        active[count] = row
        at_upper[count] = upward
        multiplier[count] = 0.0
        count += 1
    return False
