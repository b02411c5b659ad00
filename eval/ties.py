"""Which of several results can be told apart: Welch's test with Holm's correction."""

import warnings
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import scipy  # its stats take half a second, and come when they are used

from marl_mm.eval.intervals import CONFIDENCE


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values of a family of tests, corrected by Holm's method (Holm 1979)."""
    order = np.argsort(p_values, kind="stable")
    factors = len(p_values) - np.arange(len(p_values))
    corrected = np.empty(len(p_values))
    corrected[order] = np.maximum.accumulate(np.array(p_values)[order] * factors)
    return [float(p) for p in corrected.clip(max=1.0)]


def p_of_difference(scores: np.ndarray, others: np.ndarray) -> float:
    """P-value of the difference of two results on the same goals: the larger of two.

    One is Welch's over seeds, the other of Student's paired test over goals, as seeds
    that all reach the same share say nothing of the goals. A single seed can be told
    apart from nothing: 1.

    Args:
        scores: Scores by seed and goal, shape (seeds, goals).
        others: Scores of the other result, shape (other seeds, goals).
    """
    if min(len(scores), len(others)) < 2:
        return 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of scores that do not vary
        seeds = [values.mean(axis=1) for values in (scores, others)]
        over_seeds = scipy.stats.ttest_ind(*seeds, equal_var=False).pvalue
        goals = scores.mean(axis=0) - others.mean(axis=0)
        over_goals = scipy.stats.ttest_1samp(goals, 0.0).pvalue
    # Without any spread there is no p-value: means differ, or they do not.
    undefined = float(np.isclose(goals.mean(), 0.0))
    return float(np.nan_to_num([over_seeds, over_goals], nan=undefined).max())


def tie_groups(results: Sequence[np.ndarray]) -> list[tuple[int, ...]]:
    """Numbers of each result's tie groups, 1 for the group of the best.

    Results that share a group cannot be told apart; those that share none can, with
    all pairs corrected together.

    Args:
        results: Scores by seed and goal of each result, on the same goals.
    """
    pairs = list(combinations(range(len(results)), 2))
    p_values = holm([p_of_difference(results[a], results[b]) for a, b in pairs])
    groups = [set(range(len(results)))]
    for (first, second), p in zip(pairs, p_values, strict=True):
        if p < 1 - CONFIDENCE:  # no group may have both (Piepho 2004)
            both = [group for group in groups if {first, second} <= group]
            groups = [group for group in groups if group not in both]
            for part in (group - {out} for group in both for out in (first, second)):
                if not any(part <= group for group in groups):
                    groups = [group for group in groups if not group < part] + [part]
    means = [float(scores.mean()) for scores in results]
    groups.sort(key=lambda group: sorted(-means[i] for i in group))
    return [
        tuple(number for number, group in enumerate(groups, 1) if index in group)
        for index in range(len(results))
    ]
