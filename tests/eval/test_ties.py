"""Tie groups, by hand and by their properties."""

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from marl_mm.eval.ties import holm, p_of_difference, tie_groups


def test_holm_by_hand() -> None:
    """Three tests: the smallest p times 3, the next times 2, never below the former."""
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.9, 0.5]) == [1.0, 1.0]
    assert holm([]) == []


@given(st.lists(st.floats(0, 1), max_size=8))
def test_holm_lies_between_none_and_bonferroni(p_values: list[float]) -> None:
    for before, after in zip(p_values, holm(p_values), strict=True):
        assert before <= after <= min(1.0, before * len(p_values)) + 1e-12


def reaching(rate: float, seeds: int = 5, goals: int = 200) -> np.ndarray:
    """Scores of seeds that differ by a few goals, each on random goals."""
    rng = np.random.default_rng(0)
    return (rng.random((seeds, goals)) < rate).astype(float)


def test_results_far_apart_have_groups_of_their_own_and_near_ones_share() -> None:
    results = [reaching(0.2), reaching(0.9), reaching(0.89)]
    assert tie_groups(results) == [(2,), (1,), (1,)]


def test_a_result_between_two_is_in_both_groups() -> None:
    spread = np.linspace(-0.1, 0.1, 5)[:, None]
    noise = np.random.default_rng(0).normal(0, 0.3, (5, 100))
    results = [mean + spread + noise for mean in (0.5, 0.39, 0.3)]
    assert tie_groups(results) == [(1,), (1, 2), (2,)]


def test_a_single_seed_is_told_apart_from_nothing() -> None:
    assert p_of_difference(reaching(0.9, seeds=1), reaching(0.1)) == 1.0
    assert tie_groups([reaching(0.9, seeds=1), reaching(0.1)]) == [(1,), (1,)]
    apart = [reaching(0.9), reaching(0.5)]
    alone = [reaching(0.7, seeds=1)] * 20
    assert tie_groups([*apart, *alone]) == [(1,), (2,), *[(1, 2)] * 20]


def test_seeds_that_agree_leave_the_doubt_about_goals() -> None:
    """All seeds reach 9, and all of the other 10 of the same ten goals."""
    worse, better = np.ones((5, 10)), np.ones((5, 10))
    worse[:, 0] = 0
    assert p_of_difference(worse, better) == pytest.approx(0.343, abs=1e-3)
    assert p_of_difference(worse, worse) == 1.0
    assert p_of_difference(np.zeros((5, 10)), better) == 0.0


def test_the_variance_is_that_over_seeds_and_over_goals_less_what_is_in_both() -> None:
    """Of two seeds on three goals: 1 + 4/3 - 1/3 = 2, against one that is always 0."""
    scores = np.array([[6.0, 3.0, 0.0], [2.0, 1.0, 0.0]])
    free = 2**2 / (1**2 / 1 + (4 / 3) ** 2 / 2)
    by_hand = 2 * scipy.stats.t.sf(scores.mean() / np.sqrt(2), free)
    assert p_of_difference(scores, np.zeros((2, 3))) == pytest.approx(by_hand)


def test_two_seeds_and_two_goals_can_be_told_apart() -> None:
    results = [np.full((2, 2), 0.1), np.full((2, 2), 0.9)]
    assert p_of_difference(*results) == 0.0
    assert tie_groups(results) == [(2,), (1,)]


@pytest.mark.parametrize("over_seeds", [0.0, 0.05, 0.1])
@pytest.mark.parametrize("over_goals", [0.0, 0.2])
def test_equals_are_told_apart_no_more_often_than_the_level_says(
    over_seeds: float, over_goals: float
) -> None:
    """Of 400 pairs at most 8 %, however seeds, goals, and both methods' goals vary."""
    rng = np.random.default_rng(0)
    apart = 0
    for _ in range(400):
        hardness = 0.5 + rng.normal(0, 0.15, 200)
        pair = []
        for _ in range(2):
            of_seeds = rng.normal(0, over_seeds, (5, 1))
            rates = hardness + of_seeds + rng.normal(0, over_goals, 200)
            pair.append((rng.random((5, 200)) < rates).astype(float))
        apart += p_of_difference(*pair) < 0.05
    assert apart <= 32


@given(
    st.lists(st.tuples(st.floats(0, 1), st.integers(1, 4)), min_size=1, max_size=5),
    st.integers(0, 99),
)
def test_groups_hold_those_that_cannot_be_told_apart(
    made: list[tuple[float, int]], seed: int
) -> None:
    """Every result has a group, the best is in the first, and order does not matter."""
    rng = np.random.default_rng(seed)
    results = [(rng.random((n, 20)) < rate).astype(float) for rate, n in made]
    groups = tie_groups(results)
    assert all(groups)
    assert 1 in groups[int(np.argmax([scores.mean() for scores in results]))]
    assert {*sum(groups, ())} == {*range(1, 1 + max(map(max, groups)))}
    shares = [[bool({*a} & {*b}) for b in groups] for a in groups]
    backwards = tie_groups(results[::-1])[::-1]
    assert shares == [[bool({*a} & {*b}) for b in backwards] for a in backwards]


def test_of_groups_that_share_their_best_the_next_best_comes_first() -> None:
    best = reaching(0.97, seeds=1)
    assert tie_groups([reaching(0.9), reaching(0.5), best]) == [(1,), (2,), (1, 2)]
    assert tie_groups([reaching(0.5), reaching(0.9), best]) == [(2,), (1,), (1, 2)]
