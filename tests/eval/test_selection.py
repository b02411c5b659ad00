"""Scores of policies that cost no episode, on a game of two steps known by hand."""

import numpy as np
import pytest
import torch

from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.eval.selection import DISCOUNT, Scores, scores
from tests.algorithms.games import learnt, steps_of, team

LIKE, UNLIKE = (0.8, 0.8), (0.8, -0.8)


@pytest.fixture(scope="module")
def tried() -> EpisodeArrays:
    """Random actions of two agents, and the product of both as the reward."""
    actions = np.random.default_rng(0).uniform(-1, 1, (4_000, 2))
    return steps_of(actions, actions.prod(axis=1), team(), length=2)


def constant(*action: float) -> LearnedPolicy:
    """A policy that has learnt one action."""
    actions = np.tile(action, (200, 1))
    return learnt("mabc", steps_of(actions, np.ones(200), team(), length=2), 300)


@pytest.fixture(scope="module")
def scored(tried: EpisodeArrays) -> dict[tuple[float, float], Scores]:
    return {
        action: scores(constant(*action), tried, updates=600)
        for action in (LIKE, UNLIKE)
    }


@pytest.mark.slow
def test_a_critic_that_sees_all_knows_what_the_agents_do_together(
    scored: dict[tuple[float, float], Scores],
) -> None:
    """A product, which no agent's own critic can tell."""
    for action, score in scored.items():
        value = np.prod(action) * (1 + DISCOUNT)
        assert score.fqe == pytest.approx(value, abs=0.2)
        assert abs(score.fqe_agents) < 0.3


@pytest.mark.slow
def test_a_long_episode_is_worth_the_sum_of_its_rewards() -> None:
    """Values have to come back from the end of 20 steps, in as few updates as usual."""
    actions = np.random.default_rng(0).uniform(-1, 1, (4_000, 2))
    arrays = steps_of(actions, np.ones(4_000), team(), length=20)
    value = (1 - DISCOUNT**20) / (1 - DISCOUNT)
    score = scores(constant(*LIKE), arrays)
    assert score.fqe == pytest.approx(value, rel=0.05)
    assert score.fqe_agents == pytest.approx(value, rel=0.05)


@pytest.mark.slow
def test_the_distance_to_the_data_is_that_of_its_actions(
    tried: EpisodeArrays, scored: dict[tuple[float, float], Scores]
) -> None:
    for action, score in scored.items():
        distance = np.square(tried.actions - np.array(action)).mean()
        assert score.cloning == pytest.approx(-distance, rel=0.05)


@pytest.mark.slow
def test_scores_are_the_same_bytes_again(
    tried: EpisodeArrays, scored: dict[tuple[float, float], Scores]
) -> None:
    assert scores(constant(*LIKE), tried, updates=600) == scored[LIKE]


def test_torchs_own_stream_is_left_alone(tried: EpisodeArrays) -> None:
    policy, before = learnt("ma-flow-bc", tried, updates=1), torch.get_rng_state()
    scores(policy, tried, updates=1)
    assert torch.equal(torch.get_rng_state(), before)
