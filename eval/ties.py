"""Which of several results can be told apart: a t-test with Holm's correction."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import scipy  # its stats take half a second, and come when they are used

from marl_mm.eval.intervals import CONFIDENCE

_NO_VARIANCE = 1e-12
"""Variance of a mean below which it counts as 0."""


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values of a family of tests, corrected by Holm's method (Holm 1979)."""
    order = np.argsort(p_values, kind="stable")
    factors = len(p_values) - np.arange(len(p_values))
    corrected = np.empty(len(p_values))
    corrected[order] = np.maximum.accumulate(np.array(p_values)[order] * factors)
    return [float(p) for p in corrected.clip(max=1.0)]


def p_of_difference(scores: np.ndarray, others: np.ndarray) -> float:
    """P-value of the difference of two results, over seeds and goals.

    Seeds are each result's own; goals are the same for both. The difference's variance
    is that over seeds and that over goals, less what is counted twice, or the larger of
    the two where that is more (two-way clusters, Cameron, Gelbach and Miller 2011). Its
    degrees of freedom are Welch's. With a single seed or goal it cannot be estimated,
    and the p-value is 1.

    Args:
        scores: Scores by seed and goal, shape (seeds, goals).
        others: Scores of the other result, shape (other seeds, goals).
    """
    both = scores, others
    if min(*scores.shape, *others.shape) < 2:
        return 1.0
    difference = scores.mean(axis=0) - others.mean(axis=0)
    clusters = [*(values.mean(axis=1) for values in both), difference]
    parts = np.array([np.var(means, ddof=1) / len(means) for means in clusters])
    free = [len(means) - 1 for means in clusters]
    seeds, goals = parts[:2].sum(), parts[2]
    twice = sum(_residual(values) for values in both)
    mean, variance = difference.mean(), max(seeds, goals, seeds + goals - twice)
    if variance < _NO_VARIANCE:  # means differ, or they do not
        return float(np.isclose(mean, 0.0))
    errors = abs(mean) / np.sqrt(variance)
    return float(2 * scipy.stats.t.sf(errors, variance**2 / np.sum(parts**2 / free)))


def _residual(scores: np.ndarray) -> float:
    """Variance of the mean from what neither seed nor goal explains."""
    seeds, goals = scores.shape
    rest = scores - scores.mean(axis=1, keepdims=True) - scores.mean(axis=0)
    free = (seeds - 1) * (goals - 1)
    return float(np.square(rest + scores.mean()).sum() / free / scores.size)


def tie_groups(results: Sequence[np.ndarray]) -> list[tuple[int, ...]]:
    """Numbers of each result's tie groups, 1 for the group of the best.

    Results that share a group cannot be told apart; those that share none can, with
    all pairs corrected together. Those of a single seed or goal are in all groups.

    Args:
        results: Scores by seed and goal of each result, on the same goals.
    """
    testable = [i for i, scores in enumerate(results) if min(scores.shape) > 1]
    pairs = list(combinations(testable, 2))  # the others' tests would only weaken these
    p_values = holm([p_of_difference(results[a], results[b]) for a, b in pairs])
    groups = [set(range(len(results)))]
    for (first, second), p in zip(pairs, p_values, strict=True):
        if p < 1 - CONFIDENCE:  # no group may have both (Piepho 2004)
            both = [group for group in groups if {first, second} <= group]
            groups = [group for group in groups if group not in both]
            for part in (group - {out} for group in both for out in (first, second)):
                if not any(part <= group for group in groups):
                    groups.append(part)
    means = [float(scores.mean()) for scores in results]
    groups.sort(key=lambda group: sorted(-means[i] for i in group))
    return [
        tuple(number for number, group in enumerate(groups, 1) if index in group)
        for index in range(len(results))
    ]
