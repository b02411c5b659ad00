"""Success on several datasets: interquartile mean, and probability of improvement.

Intervals are of 95 %, of a stratified bootstrap with a fixed seed: within each dataset
seeds and goals are drawn anew, goals alike for all seeds and algorithms, and for all
datasets that are evaluated on the same (Agarwal et al. 2021, arXiv 2108.13264, who draw
seeds alone). Of n seeds n - 1 are drawn, as of few seeds n vary too little (Rao and Wu
1988, doi 10.1080/01621459.1988.10478591). To draw both counts three times what neither
seed nor goal explains (pigeonhole bootstrap, Owen 2007, doi 10.1214/07-AOAS122): where
little else varies, intervals are up to sqrt(3) times too wide.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from marl_mm.eval.intervals import percentile_interval

RESAMPLES = 2_000
"""Number of resamplings."""


class Estimate(NamedTuple):
    """A number and its interval."""

    value: float
    """The number itself."""

    low: float
    """Lower end of its interval; nan of a single seed."""

    high: float
    """Upper end of its interval; nan of a single seed."""


class Means(NamedTuple):
    """Each seed's mean on a dataset."""

    observed: np.ndarray
    """As it is, shape (1, seeds)."""

    drawn: np.ndarray
    """Of seeds and goals drawn anew, shape (``RESAMPLES``, seeds - 1)."""


def resampled(
    scores: Sequence[np.ndarray],
    number: int = 0,
    goals_of: Sequence[int] | None = None,
    places: Sequence[int] | None = None,
) -> list[Means]:
    """Means of all seeds, and of seeds and goals that are drawn anew.

    Args:
        scores: Scores of each dataset by seed and goal, shape (seeds, goals).
        number: Number of the algorithm: the seeds of another are drawn anew, its goals
            are the same.
        goals_of: Number of each dataset's set of goals, which are drawn alike for all
            that share it; default one of its own.
        places: Number of each dataset, so that draws are the same whichever others
            there are; default its place in ``scores``.
    """
    means = []
    places = range(len(scores)) if places is None else places
    for place, same, of_dataset in zip(places, goals_of or places, scores, strict=True):
        seeds, goals = of_dataset.shape
        rng = np.random.default_rng((place, seeds, number))
        picks = rng.integers(seeds, size=(RESAMPLES, seeds - 1))
        drawn = np.take_along_axis(_shares(same, goals) @ of_dataset.T, picks, axis=1)
        means.append(Means(of_dataset.mean(axis=1)[None], drawn))
    return means


@lru_cache(maxsize=16)
def _shares(number: int, goals: int) -> np.ndarray:
    """Shares of the goals of a set in each resampling, (``RESAMPLES``, goals)."""
    rng = np.random.default_rng((number, goals))
    return rng.multinomial(goals, np.full(goals, 1 / goals), RESAMPLES) / goals


def interquartile(means: Sequence[Means]) -> Estimate:
    """Mean over seeds and datasets without the lowest and the highest quarter.

    Scores on the border of a quarter count in part: the interval is of other numbers of
    seeds, and quarters that are rounded would make it one of another statistic.
    """

    def middle(every: Sequence[np.ndarray]) -> np.ndarray:
        scores = np.sort(np.hstack(every), axis=1)
        edges = np.linspace(0, 1, scores.shape[1] + 1).clip(0.25, 0.75)
        of_middle: np.ndarray = scores @ (2 * np.diff(edges))
        return of_middle

    return _estimate(middle, means)


def mean(means: Sequence[Means]) -> Estimate:
    """Mean over datasets of the means over seeds."""
    return _estimate(
        lambda every: np.mean([of.mean(axis=1) for of in every], axis=0), means
    )


def improvement(means: Sequence[Means], others: Sequence[Means]) -> Estimate:
    """Probability that a run reaches more than one of another algorithm.

    It is the mean over datasets of the share of pairs of seeds; equal ones count half.

    Args:
        means: Means of the algorithm.
        others: Means of the other one, on the same datasets.
    """

    def chance(every: Sequence[np.ndarray]) -> np.ndarray:
        signs = [
            np.sign(first[:, :, None] - second[:, None, :]).mean(axis=(1, 2))
            for first, second in zip(
                every[: len(means)], every[len(means) :], strict=True
            )
        ]
        return np.asarray(np.mean(signs, axis=0) + 1) / 2

    return _estimate(chance, [*means, *others])


def _estimate(
    statistic: Callable[[Sequence[np.ndarray]], np.ndarray], means: Sequence[Means]
) -> Estimate:
    """A statistic of all datasets' means, and the interval of those drawn anew."""
    (value,) = statistic([dataset.observed for dataset in means])
    if min(dataset.observed.size for dataset in means) == 1:
        return Estimate(float(value), np.nan, np.nan)
    drawn = statistic([dataset.drawn for dataset in means])
    return Estimate(float(value), *percentile_interval(drawn))
