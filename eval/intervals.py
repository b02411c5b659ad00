"""Means, deviations and intervals, of success first: over few seeds and many goals."""

import math
import warnings
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import scipy  # its stats take a second, and come when they are used
from scipy.special import ndtri, stdtrit

from marl_mm.eval.grouping import grouped, mean_of

CONFIDENCE = 0.95

_RESAMPLES = 2_000
"""Number of resamplings of the interquartile mean's bootstrap."""


def success_interval(successes: int, episodes: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a success rate, as ``scipy.stats`` has it."""
    rate, z = successes / episodes, ndtri((1 + CONFIDENCE) / 2)
    scale = 2 * (episodes + z**2)
    middle = (2 * episodes * rate + z**2) / scale
    half = z / scale * math.sqrt(4 * episodes * rate * (1 - rate) + z**2)
    low = middle - half if successes else 0.0
    high = middle + half if successes < episodes else 1.0
    return float(low), float(high)


def paired_interval(
    successes: Sequence[bool] | np.ndarray, others: Sequence[bool] | np.ndarray
) -> tuple[float, float]:
    """95 % interval of the difference of two success rates on the same goals.

    Wald's, with a goal added to each way in which the two can differ (Bonett and Price
    2012): unlike a bootstrap's it has a width where they agree on every goal.
    """
    first, second = np.asarray(successes, bool), np.asarray(others, bool)
    better, worse = 1 + np.sum(first & ~second), 1 + np.sum(second & ~first)
    goals = len(successes) + 2
    difference = (better - worse) / goals
    variance = ((better + worse) / goals - difference**2) / goals
    width = ndtri((1 + CONFIDENCE) / 2) * np.sqrt(variance)
    return max(float(difference - width), -1.0), min(float(difference + width), 1.0)


def bootstrap_interval(
    values: np.ndarray, resamples: int = 10_000
) -> tuple[float, float]:
    """95 % percentile interval of the mean, by resampling with a fixed seed."""
    picks = _picks(len(values), resamples)
    return percentile_interval(np.asarray(values)[picks].mean(axis=1))


@lru_cache(maxsize=1)  # what is compared has as many goals as what came before
def _picks(values: int, resamples: int) -> np.ndarray:
    """Indices of resampled values, which take longer to draw than to use."""
    return np.random.default_rng(0).integers(values, size=(resamples, values))


def percentile_interval(drawn: np.ndarray) -> tuple[float, float]:
    """The inner 95 % of numbers that a bootstrap drew."""
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(drawn, [tail, 1 - tail])
    return float(low), float(high)


def deviation(rates: Sequence[float]) -> float:
    """Standard deviation over seeds, estimated; 0 of a single one."""
    return float(np.std(rates, ddof=1)) if len(rates) > 1 else 0.0


def mean_interval(
    values: Sequence[float] | np.ndarray, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Student's interval of a mean of few values, by default of 95 %."""
    spread = np.std(values, ddof=1) / np.sqrt(len(values))
    width = stdtrit(len(values) - 1, (1 + confidence) / 2) * spread
    return float(np.mean(values) - width), float(np.mean(values) + width)


def difference_interval(
    values: Sequence[float], others: Sequence[float]
) -> tuple[float, float]:
    """Welch's 95 % interval of the difference of two means of few values.

    nan if neither side varies.
    """
    if np.ptp(values) == np.ptp(others) == 0:
        return np.nan, np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of one that does not vary
        test = scipy.stats.ttest_ind(values, others, equal_var=False)
    interval = test.confidence_interval(CONFIDENCE)
    return float(interval.low), float(interval.high)


def wider_interval(rates: Sequence[float], goals: int) -> tuple[float, float]:
    """95 % interval of a success rate: on each side the wider of two.

    Student's interval over seeds says nothing of the goals where all seeds reach the
    same share, and Wilson's over goals says nothing of how much seeds differ.

    Args:
        rates: Success rates by seed.
        goals: Number of goals, which are the same for all seeds.
    """
    over_goals = success_interval(round(float(np.mean(rates)) * goals), goals)
    low, high = _widened(over_goals, rates)
    return max(low, 0.0), min(high, 1.0)


def interval_of_mean(values: np.ndarray) -> tuple[float, float]:
    """95 % interval of a mean: on each side the wider of two.

    One is Student's over seeds, the other a bootstrap over goals of the seeds' means.
    Their variances are not added. Where seeds vary as much as goals do, Student's
    factor makes up for that with three seeds (95 % of the intervals hold the mean), but
    less with more: 92 % with five, 87 % with 20.

    Args:
        values: Values by seed and goal, shape (seeds, goals).
    """
    return _widened(bootstrap_interval(values.mean(axis=0)), values.mean(axis=1))


def interval_of_gain(gain: np.ndarray) -> tuple[float, float]:
    """95 % interval of a mean difference of successes; see ``interval_of_mean``.

    For the bootstrap a goal is added to each way in which two can differ, as in
    ``paired_interval``, so that it has a width where they agree on every goal.

    Args:
        gain: Differences by seed and goal, shape (seeds, goals).
    """
    of_goals = np.append(gain.mean(axis=0), (1.0, -1.0))
    return _widened(bootstrap_interval(of_goals), gain.mean(axis=1))


def _widened(
    interval: tuple[float, float], of_seeds: Sequence[float] | np.ndarray
) -> tuple[float, float]:
    """The wider to each side of an interval and Student's over seeds, if several."""
    low, high = interval
    if len(of_seeds) > 1:
        over_seeds = mean_interval(of_seeds)
        low, high = min(low, over_seeds[0]), max(high, over_seeds[1])
    return low, high


def seed_rates(rows: Sequence[Mapping[str, Any]]) -> list[float]:
    """Each seed's success rate, in the order of seeds."""
    by_seed = sorted(grouped(rows, "seed").items())
    return [mean_of(goals, "success") for _, goals in by_seed]


def summarize_success(rows: Sequence[Mapping[str, Any]], name: str) -> dict[str, Any]:
    """Mean over seeds, deviation and interval; interquartile mean and its interval.

    Args:
        rows: Evaluated episodes of all seeds.
        name: Beginning of the values' names.
    """
    rates, scores = seed_rates(rows), success_scores(rows)
    goals = len({row["goal"] for row in rows})
    return {
        name: float(np.mean(rates)),
        f"{name}_std": deviation(rates),
        f"{name}_interval": wider_interval(rates, goals),
        f"{name}_iqm": interquartile_mean(scores),
        f"{name}_iqm_interval": interquartile_interval(scores),
    }


def success_scores(rows: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Success rates by seed and direction, shape (seeds, 2): as many goals in each.

    Where all goals are on one side, or on none that is named, shape (seeds, 1).
    """
    groups = grouped(rows, "direction")
    sides = [groups[side] for side in ("forward", "backward") if side in groups]
    sides = sides or [list(rows)]
    return np.array([seed_rates(side) for side in sides]).T


def interquartile_mean(scores: np.ndarray) -> float:
    """Mean without the lowest and the highest quarter (Agarwal 2021).

    The quarters are rounded down: of six scores one is left out at each end.
    """
    return float(scipy.stats.trim_mean(scores, 0.25, axis=None))


def interquartile_interval(scores: np.ndarray) -> tuple[float, float]:
    """95 % stratified bootstrap interval of the interquartile mean; nan of one run.

    Runs are drawn with replacement and a fixed seed, each column by itself (Agarwal
    2021).

    Args:
        scores: Shape (runs, columns).
    """
    if len(scores) == 1:
        return np.nan, np.nan
    rng = np.random.default_rng(0)
    picks = rng.integers(len(scores), size=(_RESAMPLES, *scores.shape))
    drawn = np.take_along_axis(scores[None], picks, axis=1)
    means = scipy.stats.trim_mean(drawn.reshape(_RESAMPLES, -1), 0.25, axis=1)
    return percentile_interval(means)
