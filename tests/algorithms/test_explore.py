"""Noise is of half of each action's range, and actions stay within it."""

import numpy as np
import pytest

from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.pretrained import load_pretrained
from marl_mm.envs.tasks.reach import LAYOUT

LOW, HIGH = np.array(LAYOUT.low), np.array(LAYOUT.high)
STATE = np.zeros(len(LAYOUT.state))


@pytest.fixture(scope="module")
def policy() -> LearnedPolicy:
    return load_pretrained()


def drawn(policy: LearnedPolicy, noise: float, share: float) -> np.ndarray:
    explorer = Explorer(policy, noise, share)
    explorer.begin(np.random.default_rng(0), LAYOUT)
    return np.array([explorer.act(STATE) for _ in range(4_000)])


def test_noise_is_around_the_policy_s_action(policy: LearnedPolicy) -> None:
    """So little that it is never cut off."""
    actions = drawn(policy, 0.001, 0.0)
    calm = policy.act(STATE)
    inside = (calm > LOW + 0.02 * (HIGH - LOW)) & (calm < HIGH - 0.02 * (HIGH - LOW))
    assert inside.sum() >= 2
    spread = (actions - calm).std(axis=0) / ((HIGH - LOW) / 2)
    np.testing.assert_allclose(spread[inside], 0.001, rtol=0.05)
    np.testing.assert_allclose(
        (actions - calm).mean(axis=0)[inside], 0, atol=1e-4 * (HIGH - LOW).max()
    )


def test_actions_stay_in_range_and_reach_its_ends(policy: LearnedPolicy) -> None:
    actions = drawn(policy, 3.0, 0.0)
    low, high = LOW.astype(np.float32), HIGH.astype(np.float32)
    assert (actions.min(axis=0) == low).all() and (actions.max(axis=0) == high).all()
    assert actions.dtype == np.float32


def test_random_steps_are_uniform_and_as_many_as_asked(policy: LearnedPolicy) -> None:
    actions = drawn(policy, 0.0, 0.25)
    random = (actions != policy.act(STATE)).any(axis=1)
    assert random.mean() == pytest.approx(0.25, abs=0.03)
    middle, width = (LOW + HIGH) / 2, HIGH - LOW
    share = (actions[random] - middle) / width
    assert abs(share.mean(axis=0)).max() < 0.05
    np.testing.assert_allclose(share.std(axis=0), 12**-0.5, atol=0.02)
