"""The priority matrices of the paper and what lies between them."""

import numpy as np
import pytest

from marl_mm.control.priorities import REACHING, STABILITY, priority_matrix
from marl_mm.control.reference.hierarchy import handled_tasks


def test_stability_matrix_is_table_1_in_cumulative_coding() -> None:
    expected = [
        [1, 1, 0, 0, 0],  # base velocity and orientation from level 1 on
        [1, 1, 1, 0, 0],  # manipulator position joins at level 2
        [1, 1, 1, 1, 0],
        [1, 1, 1, 1, 1],
    ]
    np.testing.assert_array_equal(STABILITY, expected)


def test_reaching_matrix_is_table_1_in_cumulative_coding() -> None:
    expected = [[0, 0, 1, 0, 0], [0, 0, 1, 1, 0], [1, 1, 1, 1, 0], [1, 1, 1, 1, 1]]
    np.testing.assert_array_equal(REACHING, expected)


@pytest.mark.parametrize("alpha", np.linspace(0, 1, 11))
def test_columns_never_decrease(alpha: float) -> None:
    assert (np.diff(priority_matrix(alpha), axis=0) >= 0).all()


@pytest.mark.parametrize("alpha", [0.01, 0.5, 0.99])
def test_handled_sets_between_the_ends(alpha: float) -> None:
    psi = priority_matrix(alpha)
    sets = [set(handled_tasks(psi, level)) for level in range(4)]
    assert sets == [{0, 1, 2}, {2, 3}, {0, 1, 3}, {4}]


def test_handled_tasks_come_in_descending_priority() -> None:
    assert handled_tasks(priority_matrix(0.9), 0) == [0, 1, 2]
    assert handled_tasks(priority_matrix(0.1), 0) == [2, 0, 1]
