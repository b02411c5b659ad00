"""Single-agent algorithms and their team forms: one code, and what sets them apart."""

from typing import Any

import numpy as np
import pytest

from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.contracts.learners import candidate, several_layouts, some_episodes
from marl_mm.datasets.arrays import EpisodeArrays
from tests.algorithms.games import learnt, played, same_state, steps_of, team

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
}
"""Joint forms by team forms."""

ONE_FORM = {"omar", "maicq", "q-chunking"}
"""Team forms whose additions are about several agents, and a joint form for chunks."""

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
