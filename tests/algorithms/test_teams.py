"""Single-agent algorithms and their team forms: one code, and what sets them apart."""

from typing import Any

import numpy as np
import pytest
import torch

from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.contracts.learners import candidate, several_layouts, some_episodes
from marl_mm.datasets.arrays import EpisodeArrays
from tests.algorithms.games import (
    learner_of,
    learnt,
    played,
    same_state,
    steps_of,
    team,
)

PAIRS = {
    "mabc": "bc",
    "ma-flow-bc": "flow-bc",
    "matd3-bc": "td3-bc",
    "ma-iql": "iql",
    "ma-rebrac": "rebrac",
    "cfcql": "cql",
    "mac-flow": "fql",
    "best-of-n": "best-of-n-joint",
    "ma-cal-ql": "cal-ql",
    "ma-rlpd": "rlpd",
    "ma-q-chunking": "q-chunking",
}
"""Joint forms by team forms."""

ONE_FORM = {"omar", "maicq"}
"""Team forms whose additions are about several agents."""

XOR = np.array([[1.0, -1.0], [-1.0, 1.0]])
"""Actions of two conventions; to mix them is lost."""


@pytest.mark.parametrize("name", PAIRS)
def test_a_team_of_one_that_sees_all_is_the_single_agent(name: str) -> None:
    alone = several_layouts(some_episodes())["one agent"]
    states = [
        candidate(form).state(candidate(form).trained(alone, (3,)))
        for form in (name, PAIRS[name])
    ]
    assert same_state(*states)


def test_all_team_forms_but_the_listed_have_a_joint_one() -> None:
    offline = {n for n, algorithm in ALGORITHMS.items() if not algorithm.online}
    assert offline == {*PAIRS, *PAIRS.values(), *ONE_FORM}


def conventions(rewards: tuple[float, float] = (1.0, 1.0)) -> EpisodeArrays:
    """Steps of both conventions, and their rewards."""
    first = np.arange(200) < 100
    actions = np.where(first[:, None], XOR[0], XOR[1])
    return steps_of(actions, np.where(first, *rewards), team())


def kept(actions: np.ndarray) -> float:
    """Share of episodes whose actions are those of one of the conventions."""
    off = np.abs(actions[:, 0, None] - XOR).max(axis=2).min(axis=1)
    return float((off < 0.3).mean())


def test_means_of_two_conventions_are_none_of_them() -> None:
    for name in ("bc", "mabc"):
        acted = played(learnt(name, conventions()), episodes=1)
        np.testing.assert_allclose(acted[0, 0], [0.0, 0.0], atol=0.1)


@pytest.mark.slow
def test_a_joint_flow_keeps_to_conventions_and_flows_of_agents_do_not() -> None:
    """Each agent's own actions are those of the data; half of the pairs are not."""
    large: Any = {"updates": 2_000, "hidden": (64, 64), "batch_size": 128}
    joint = played(learnt("flow-bc", conventions(), **large, flow_steps=30))
    apart = played(learnt("ma-flow-bc", conventions(), **large, flow_steps=30))
    assert kept(joint) > 0.95
    assert 0.35 < kept(apart) < 0.65
    for actions in (joint, apart):
        assert np.mean(np.abs(np.abs(actions) - 1.0) < 0.3) > 0.95
        assert 0.4 < np.mean(actions[:, 0, 0] > 0) < 0.6


@pytest.mark.slow
def test_iql_follows_the_better_convention() -> None:
    data = conventions(rewards=(1.0, 0.0))
    for name in ("iql", "ma-iql"):
        acted = played(learnt(name, data, temperature=10.0), episodes=1)
        np.testing.assert_allclose(acted[0, 0], XOR[0], atol=0.15)


FAR = {"q_weight": 20.0, "actor_learning_rate": 2e-3, "critic_learning_rate": 2e-3}
QUICK = {"learning_rate": 2e-3}
FREE: dict[str, dict[str, Any]] = {
    "td3-bc": {**FAR, "future": 0.0, "elsewhere": 0.0},
    "matd3-bc": {**FAR, "future": 0.0, "elsewhere": 0.0},
    "rebrac": {**QUICK, "actor_weight": 0.01, "critic_weight": 0.0},
    "ma-iql": {**QUICK, "temperature": 10.0, "expectile": 0.9},
    "fql": {**QUICK, "distillation": 0.1},
    "mac-flow": {**QUICK, "distillation": 0.1},
    "best-of-n": {**QUICK, "samples": 16, "expectile": 0.9},
    "omar": {**QUICK, "conservatism": 0.05},
}
"""Settings of algorithms with critics in which values outweigh the data's actions."""


@pytest.mark.slow
@pytest.mark.parametrize("name", FREE)
def test_two_steps_of_a_team_are_valued_and_acted_at_their_best(name: str) -> None:
    """Each step costs a quadratic of both actions, least at (1/2, 1/2); the second pays
    1. So with discount 0.9 the best is worth 1 at the second step, and 0.9 at the
    first: less for those that value what data do next, here at random."""
    actions = np.random.default_rng(0).uniform(-1, 1, (1_500, 2, 2))
    miss, apart = actions.sum(axis=2) - 1, actions[..., 0] - actions[..., 1]
    rewards = [0.0, 1.0] - np.square(miss) - 0.1 * np.square(apart)
    data = steps_of(actions.reshape(-1, 2), rewards.ravel(), team(), length=2)
    learner = learner_of(name, data, discount=0.9, target_rate=0.02, **FREE[name])
    states = [(0.0, 0.0), (1.0, 0.0)]
    policy = LearnedPolicy(name, learner.agents(0), learner.layout)
    acted = played(policy, 30, states).mean(axis=0)
    np.testing.assert_allclose(acted.sum(axis=1), 1.0, atol=0.25)
    np.testing.assert_allclose(acted, 0.5, atol=0.3)
    with torch.no_grad():
        state = learner.normalizer(torch.tensor([states]))
        best = learner.critics.least(state, torch.full((1, 2, 2), 0.5)).flatten()
    lowest = 0.15 if name in ("ma-iql", "best-of-n") else 0.65
    assert lowest < float(best[0]) < 0.95
    assert float(best[1]) == pytest.approx(1.0, abs=0.1)
