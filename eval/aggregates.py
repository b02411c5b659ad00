"""Success on several datasets: interquartile mean, and probability of improvement.

Intervals are of 95 %, of a stratified bootstrap with a fixed seed: within each dataset
seeds and goals are drawn anew, goals alike for all seeds and algorithms, and for all
datasets that are evaluated on the same (Agarwal et al. 2021, arXiv 2108.13264, who draw
seeds alone).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy  # its stats take a second, and come when they are used

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
    """Upper end; likewise."""


Means = Sequence[np.ndarray]
"""Each seed's mean on every dataset, as it is and then drawn anew: arrays of shape
(1 + ``RESAMPLES``, seeds)."""


def resampled(
    scores: Sequence[np.ndarray],
    number: int = 0,
    goals_of: Sequence[int] | None = None,
) -> Means:
    """Means of all seeds, and of seeds and goals that are drawn anew.

    Args:
        scores: Scores of each dataset by seed and goal, shape (seeds, goals).
        number: Number of the algorithm: the seeds of another are drawn anew, its goals
            are the same.
        goals_of: Number of each dataset's set of goals, which are drawn alike for all
            that share it; default one of its own.
    """
    means = []
    for place, of_dataset in enumerate(scores):
        seeds, goals = of_dataset.shape
        rng = np.random.default_rng((goals_of[place] if goals_of else place, goals))
        shares = rng.multinomial(goals, np.full(goals, 1 / goals), RESAMPLES) / goals
        rng = np.random.default_rng((place, seeds, number))
        picks = rng.integers(seeds, size=(RESAMPLES, seeds))
        drawn = np.take_along_axis(shares @ of_dataset.T, picks, axis=1)
        means.append(np.concatenate([of_dataset.mean(axis=1)[None], drawn]))
    return means


def interquartile(means: Means) -> Estimate:
    """Mean over seeds and datasets without the lowest and the highest quarter."""
    every = np.concatenate(means, axis=1)
    return _estimate(scipy.stats.trim_mean(every, 0.25, axis=1), means)


def mean(means: Means) -> Estimate:
    """Mean over datasets of the means over seeds."""
    return _estimate(np.mean([of.mean(axis=1) for of in means], axis=0), means)


def improvement(means: Means, others: Means) -> Estimate:
    """Probability that a run reaches more than one of another algorithm.

    It is the mean over datasets of the share of pairs of seeds; equal ones count half.

    Args:
        means: Means of the algorithm.
        others: Means of the other one, on the same datasets.
    """
    signs = [
        np.sign(first[:, :, None] - second[:, None, :]).mean(axis=(1, 2))
        for first, second in zip(means, others, strict=True)
    ]
    return _estimate((np.mean(signs, axis=0) + 1) / 2, [*means, *others])


def _estimate(values: np.ndarray, of: Means) -> Estimate:
    """The first value, and the interval that the others give."""
    if min(means.shape[1] for means in of) == 1:
        return Estimate(float(values[0]), np.nan, np.nan)
    return Estimate(float(values[0]), *percentile_interval(values[1:]))
