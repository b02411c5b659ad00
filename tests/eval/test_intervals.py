"""Means and intervals of success, by hand and from textbooks."""

import numpy as np
import pytest
import scipy.stats

from marl_mm.eval.intervals import (
    bootstrap_interval,
    difference_interval,
    interquartile_interval,
    interquartile_mean,
    interval_of_gain,
    interval_of_mean,
    mean_interval,
    paired_interval,
    success_interval,
    success_scores,
    wider_interval,
)


@pytest.mark.parametrize(
    ("successes", "episodes", "low", "high"),
    [(0, 10, 0.0, 0.2775), (5, 10, 0.2366, 0.7634), (100, 100, 0.9630, 1.0)],
)
def test_wilson_interval_from_the_textbook(
    successes: int, episodes: int, low: float, high: float
) -> None:
    assert success_interval(successes, episodes) == pytest.approx((low, high), abs=1e-4)


def test_the_paired_interval_by_hand() -> None:
    """3 of 10 goals are won and 1 is lost: (4 - 2) / 12 +- 1.96 sqrt(0.03935)."""
    now = [True] * 3 + [False] + [True] * 6
    clean = [False] * 3 + [True] + [True] * 6
    expected = 1 / 6 - 0.3888, 1 / 6 + 0.3888
    assert paired_interval(now, clean) == pytest.approx(expected, abs=1e-4)
    low, high = paired_interval(clean, now)
    assert (low, high) == pytest.approx((-expected[1], -expected[0]), abs=1e-4)
    low, high = paired_interval(now, now)
    assert low == -high and high == pytest.approx(0.2309, abs=1e-4)


def test_bootstrap_interval_is_that_of_the_mean() -> None:
    values = np.random.default_rng(0).normal(3, 2, 400)
    low, high = bootstrap_interval(values)
    assert (low + high) / 2 == pytest.approx(values.mean(), abs=0.02)
    assert (high - low) / 2 == pytest.approx(1.96 * 2 / 20, rel=0.1)
    assert bootstrap_interval(values) == (low, high)


def test_the_interval_of_three_by_hand() -> None:
    """t(2, 0.975) = 4.303; standard error of 1, 2, 3 is 1 / sqrt(3)."""
    assert mean_interval([1, 2, 3]) == pytest.approx((2 - 2.484, 2 + 2.484), abs=1e-3)


def test_seeds_that_agree_leave_the_doubt_about_goals() -> None:
    """Which are no more for being gone to with several seeds."""
    for rates in ([0.5], [0.5, 0.5], [0.5, 0.5, 0.5]):
        assert wider_interval(rates, 20) == success_interval(10, 20)


def test_seeds_that_differ_widen_the_interval_as_far_as_a_rate_can_go() -> None:
    low, high = wider_interval([0.4, 0.5, 0.6], 1000)
    assert (low, high) == pytest.approx((0.5 - 0.2484, 0.5 + 0.2484), abs=1e-3)
    assert wider_interval([0.0, 1.0], 100) == (0.0, 1.0)


def test_seeds_that_agree_on_every_goal_tell_nothing_more_of_goals() -> None:
    goals = np.linspace(-1, 1, 100)
    for seeds in (1, 2, 3):
        assert interval_of_mean(np.stack([goals] * seeds)) == bootstrap_interval(goals)
    low, high = interval_of_mean(np.stack([goals - 1, goals, goals + 1]))
    assert (low, high) == pytest.approx((-2.484, 2.484), abs=1e-3)


def test_a_gain_of_nothing_has_the_width_of_a_goal_each_way() -> None:
    """Without a difference it is the paired interval's; with one it holds it, too."""
    same = np.zeros((3, 200))
    low, high = interval_of_gain(same)
    expected = paired_interval([True] * 200, [True] * 200)
    assert (low, high) == pytest.approx(expected, abs=2e-3) and low < 0 < high
    gain = np.random.default_rng(0).integers(-1, 2, (1, 200))
    low, high = interval_of_gain(gain)
    inner = bootstrap_interval(gain[0])
    assert high - low > inner[1] - inner[0] and low < gain.mean() < high


def test_intervals_are_those_of_scipy_to_the_bit() -> None:
    """Its ``stats`` take a second to import, which every evaluation would wait for."""
    for episodes in (1, 7, 50, 200):
        for successes in range(episodes + 1):
            test = scipy.stats.binomtest(successes, episodes)
            wilson = test.proportion_ci(0.95, method="wilson")
            assert success_interval(successes, episodes) == (wilson.low, wilson.high)
    for count in (2, 5, 30):
        values = np.random.default_rng(count).random(count)
        width = scipy.stats.t.ppf(0.975, count - 1) * values.std(ddof=1)
        low, high = mean_interval(values)
        assert high - low == pytest.approx(2 * width / np.sqrt(count), rel=1e-12)


def test_scores_by_seed_and_direction() -> None:
    hits = {
        (0, "forward"): 2,
        (0, "backward"): 1,
        (1, "forward"): 0,
        (1, "backward"): 2,
    }
    rows = [
        {"seed": seed, "direction": direction, "success": int(goal < reached)}
        for (seed, direction), reached in hits.items()
        for goal in range(2)
    ]
    assert success_scores(rows).tolist() == [[1.0, 0.5], [0.0, 1.0]]
    nowhere = [row | {"direction": ""} for row in rows]
    assert success_scores(nowhere).tolist() == [[0.75], [0.5]]


def test_the_interquartile_mean_of_a_table_worked_by_hand() -> None:
    assert interquartile_mean(np.array([[0.0, 0.4], [0.6, 1.0]])) == pytest.approx(0.5)
    # Of six the highest and the lowest go, and one each: 1.5 of 6, rounded down.
    six = np.array([[0.0, 0.1], [0.5, 0.6], [0.8, 1.0]])
    assert interquartile_mean(six) == pytest.approx((0.1 + 0.5 + 0.6 + 0.8) / 4)


def test_the_interval_of_the_interquartile_mean_draws_columns_apart() -> None:
    # Whatever is drawn, the runs agree: there is nothing to be unsure of.
    assert interquartile_interval(np.array([[0.2, 0.8], [0.2, 0.8]])) == (0.5, 0.5)
    low, high = interquartile_interval(np.array([[0.0, 0.0], [1.0, 1.0]]))
    assert (low, high) == (0.0, 1.0)
    # Two runs that trade one direction for the other: each may be drawn twice.
    assert interquartile_interval(np.array([[0.0, 1.0], [1.0, 0.0]])) == (0.0, 1.0)
    assert np.isnan(interquartile_interval(np.array([[0.5, 0.5]]))).all()


def test_the_interval_of_a_difference_by_hand() -> None:
    """Two threes of the same spread: t(4, 0.975) = 2.776; its error is sqrt(2 / 3)."""
    low, high = difference_interval([3, 4, 5], [1, 2, 3])
    assert (low, high) == pytest.approx((2 - 2.267, 2 + 2.267), abs=1e-3)
    assert np.isnan(difference_interval([1, 1, 1], [0.9, 0.9, 0.9])).all()


def test_a_rate_stands_for_its_number_of_goals() -> None:
    """Such as 0.29 for 29 of 100, although 100 times 0.29 is a little less."""
    for reached in range(101):
        assert wider_interval([reached / 100], 100) == success_interval(reached, 100)


def test_only_what_varies_widens_a_difference() -> None:
    interval = difference_interval([1, 2, 3], [0, 0, 0])
    assert interval == pytest.approx(mean_interval([1, 2, 3]))
