"""The compiled QP against DAQP, and on problems that break naive active-set codes."""

import daqp
import numpy as np
import pytest

from marl_mm.control.compiled.active_set import (
    EXHAUSTED,
    SOLVED,
    solve_least_distance,
)

ITERATIONS = 60


def solve(
    rows: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[bool, np.ndarray]:
    y = np.zeros(rows.shape[1])
    columns = np.ascontiguousarray(rows.T)
    code = solve_least_distance(columns, lower, upper, y, ITERATIONS)
    return code == SOLVED, y


def test_equals_daqp_on_1000_problems() -> None:
    rng = np.random.default_rng(0)
    for _ in range(1000):
        rows = rng.normal(size=(17, 9)) * rng.uniform(0.1, 10)
        inside = rows @ rng.normal(size=9)  # so that the problem is feasible
        lower = inside - rng.uniform(0, 2, 17)
        upper = inside + rng.uniform(0, 2, 17)
        found, y = solve(rows, lower, upper)
        expected, _, flag, _ = daqp.solve(
            np.eye(9), np.zeros(9), rows, upper, lower, np.zeros(17, np.int32)
        )
        assert found and flag == 1
        np.testing.assert_allclose(y, expected, atol=1e-6)


def test_zero_is_the_answer_where_it_is_allowed() -> None:
    rows = np.random.default_rng(1).normal(size=(5, 3))
    found, y = solve(rows, -np.ones(5), np.ones(5))
    assert found
    np.testing.assert_array_equal(y, 0)


def test_one_active_row_by_hand() -> None:
    found, y = solve(np.array([[3.0, 4.0]]), np.array([10.0]), np.array([20.0]))
    assert found
    np.testing.assert_allclose(y, [1.2, 1.6])


def test_repeated_and_zero_rows_do_no_harm() -> None:
    row = np.array([1.0, 2.0, 0.5])
    rows = np.stack([row, row, 2 * row, np.zeros(3), [0.0, 0.0, 1.0]])
    lower = np.array([1.0, 1.0, 2.0, -1.0, 0.5])
    found, y = solve(rows, lower, np.full(5, 9.0))
    assert found
    assert (rows @ y >= lower - 1e-9).all()


@pytest.mark.parametrize("gap", [1e-3, 1.0])
def test_contradictory_rows_are_reported(gap: float) -> None:
    rows = np.array([[1.0, 0.0], [1.0, 0.0]])
    y = np.zeros(2)
    lower, upper = np.array([1.0, -5.0]), np.array([5.0, 1.0 - gap])
    assert solve_least_distance(rows.T.copy(), lower, upper, y, ITERATIONS) in (0, 1)


def test_running_out_of_iterations_is_told_apart() -> None:
    rows, y = np.eye(3), np.zeros(3)
    code = solve_least_distance(rows, np.ones(3), np.full(3, 2.0), y, 2)
    assert code == EXHAUSTED
