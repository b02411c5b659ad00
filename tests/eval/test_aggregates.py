"""Interquartile mean and probability of improvement over several datasets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from marl_mm.eval.aggregates import improvement, interquartile, mean, resampled


def reached(rate: float, seeds: int = 5, goals: int = 200, seed: int = 0) -> np.ndarray:
    """Success of runs that reach a share of the goals, shape (seeds, goals)."""
    rng = np.random.default_rng(seed)
    return (rng.random((seeds, goals)) < rate).astype(float)


def test_values_are_those_of_all_runs() -> None:
    scores = [reached(rate, seed=n) for n, rate in enumerate((0.1, 0.5, 0.9))]
    rates = np.concatenate([of.mean(axis=1) for of in scores])
    means = resampled(scores)
    ordered = np.sort(rates)  # of 15 scores 3.75 at each end are left out
    middle = (ordered[4:11].sum() + 0.25 * (ordered[3] + ordered[11])) / 7.5
    assert interquartile(means).value == pytest.approx(middle)
    assert mean(means).value == pytest.approx(rates.mean())


def test_the_interval_of_a_mean_is_that_of_seeds_and_goals() -> None:
    """Without spread over seeds it is the binomial's of the goals, and else wider."""
    alike = np.repeat(reached(0.5, seeds=1), 5, axis=0)
    _, low, high = mean(resampled([alike]))
    deviation = (high - low) / 2 / 1.96
    assert deviation == pytest.approx(np.sqrt(0.25 / 200), rel=0.1)
    apart = alike.copy()
    apart[0] = 0.0
    _, low, high = mean(resampled([apart]))
    assert (high - low) / 2 / 1.96 > 2 * deviation


def test_the_interval_of_few_seeds_is_not_too_narrow() -> None:
    """Its standard error is that with n - 1 in the deviation's denominator."""
    rates = np.linspace(0.2, 0.8, 5)
    _, low, high = mean(resampled([np.repeat(rates[:, None], 200, axis=1)]))
    error = rates.std(ddof=1) / np.sqrt(5)
    assert (high - low) / 2 / 1.96 == pytest.approx(error, rel=0.05)


@pytest.mark.slow
def test_the_true_mean_is_within_the_interval_about_as_often_as_it_says() -> None:
    """Of 200 experiments with true mean 0.5 the interval misses it in 1 to 12 %."""
    missed = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        rates = rng.normal(0.5, 0.05, (10, 1))
        scores = (rng.random((10, 100)) < rates).astype(float)
        _, low, high = mean(resampled([scores]))
        missed += not low <= 0.5 <= high
    assert 2 <= missed <= 24


def test_goals_that_datasets_share_are_drawn_alike() -> None:
    """The same scores on as many datasets of one task say no more than on one."""
    scores = [np.repeat(reached(0.5, seeds=1), 5, axis=0)] * 4
    once, shared, apart = (
        mean(resampled(some, goals_of=goals))
        for some, goals in ((scores[:1], [0]), (scores, [0] * 4), (scores, None))
    )
    assert shared == once and apart.high - apart.low < 0.6 * (once.high - once.low)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=3), st.integers(0, 9))
def test_one_improves_as_often_as_the_other_does_not(
    rates: list[float], seed: int
) -> None:
    one, other = (
        resampled([reached(rate, 3, 20, seed + n) for rate in rates]) for n in (0, 50)
    )
    chance, back = improvement(one, other), improvement(other, one)
    assert chance.value + back.value == pytest.approx(1.0)
    assert chance.low + back.high == pytest.approx(1.0)
    assert improvement(one, one).value == pytest.approx(0.5)


def test_a_clear_winner_improves_for_certain_and_datasets_count_alike() -> None:
    good, bad = reached(0.9), reached(0.1)
    assert improvement(resampled([good]), resampled([bad])) == (1.0, 1.0, 1.0)
    mixed = improvement(resampled([good, bad]), resampled([bad, good]))
    assert mixed.value == 0.5


def test_datasets_may_have_other_numbers_of_seeds_and_one_has_no_interval() -> None:
    means = resampled([reached(0.9, seeds=2), reached(0.1, seeds=4)])
    assert mean(means).value == pytest.approx(
        (reached(0.9, 2).mean() + reached(0.1, 4).mean()) / 2
    )
    assert not np.isnan(mean(means)).any()
    for beside in ([], [reached(0.9)]):
        value, low, high = interquartile(resampled([reached(0.9, seeds=1), *beside]))
        assert np.isnan([low, high]).all() and value > 0.8


def test_another_algorithms_seeds_are_drawn_anew_and_its_goals_are_not() -> None:
    by_seed = np.arange(5.0)[:, None].repeat(5, axis=1)
    (first, of_first), (second, of_second) = (
        resampled([by_seed, by_seed.T], number=number) for number in (0, 1)
    )
    assert (first.drawn != second.drawn).any()
    np.testing.assert_allclose(of_first.drawn, of_second.drawn)
