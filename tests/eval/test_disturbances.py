"""Policies with a disturbed agent: only what it sees or does is changed, and how."""

from threading import Lock
from typing import Any

import numpy as np
import pytest

from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError
from marl_mm.eval.disturbances import (
    Disturbed,
    Dropped,
    Frozen,
    Late,
    Mixed,
    Noisy,
    disturbed,
)
from marl_mm.layout import AgentLayout, Layout
from marl_mm.policy import Policy

BAR = make_task("Bar-v0").layout


class Means:
    """Every entry of an agent's action is the mean of what the agent sees."""

    name = "means"

    def __init__(self, layout: Layout, joint: bool) -> None:
        self._layout = layout
        if joint:
            self.agents = {"joint": layout.joint}

    def describe(self) -> dict[str, Any]:
        return {}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        assert layout == self._layout

    def act(self, state: np.ndarray) -> np.ndarray:
        action = np.empty(len(self._layout.action), np.float32)
        for agent in self._layout.agents:
            action[list(agent.action)] = state[list(agent.observation)].mean()
        return action


def acted(
    policy: Policy, states: np.ndarray, layout: Layout = BAR, seed: int = 5
) -> np.ndarray:
    """Actions of a policy in an episode of these states."""
    policy.begin(np.random.default_rng(seed), layout)
    return np.stack([policy.act(state) for state in states])


@pytest.fixture
def states() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(8, len(BAR.state)))


@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize("agent", BAR.agents, ids=lambda agent: agent.name)
@pytest.mark.parametrize("late", [1, 2, 3])
def test_late_actions_are_those_of_so_many_steps_ago(
    states: np.ndarray, agent: AgentLayout, late: int, joint: bool
) -> None:
    policy = Means(BAR, joint)
    clean = acted(policy, states)
    now = acted(disturbed(Late, policy, agent, late, np.ones(len(BAR.state))), states)
    own = list(agent.action)
    assert (now[late:, own] == clean[:-late, own]).all()
    assert (now[:late, own] == clean[0, own]).all()
    assert_others_equal(now, clean, agent)


def assert_others_equal(now: np.ndarray, clean: np.ndarray, agent: AgentLayout) -> None:
    others = [i for i in range(clean.shape[1]) if i not in agent.action]
    assert (now[:, others] == clean[:, others]).all()


@pytest.mark.parametrize("joint", [False, True])
def test_a_frozen_agent_repeats_its_last_own_action(
    states: np.ndarray, joint: bool
) -> None:
    policy, agent = Means(BAR, joint), BAR.agents[2]
    clean = acted(policy, states)
    now = acted(disturbed(Frozen, policy, agent, 3, np.ones(len(BAR.state))), states)
    own = list(agent.action)
    assert (now[:3, own] == clean[:3, own]).all()
    assert (now[3:, own] == clean[2, own]).all()
    assert_others_equal(now, clean, agent)


def test_a_dropped_view_is_the_last_one_that_was_seen(states: np.ndarray) -> None:
    policy, agent = Means(BAR, False), BAR.agents[0]
    clean = acted(policy, states)
    spread, own = np.ones(len(BAR.state)), list(agent.action)
    always = acted(disturbed(Dropped, policy, agent, 1.0, spread), states)
    assert (always[:, own] == clean[0, own]).all()
    half = acted(disturbed(Dropped, policy, agent, 0.5, spread), states)
    kept = (half == clean)[:, own].all(axis=1)
    again = (half[1:] == half[:-1])[:, own].all(axis=1)
    assert kept[0] and (kept[1:] | again).all()
    assert not kept.all() and kept.sum() > 1
    for now in (always, half):
        assert_others_equal(now, clean, agent)


@pytest.mark.parametrize("kind", [Dropped, Noisy])
def test_teams_and_joint_actors_meet_the_same_numbers(
    states: np.ndarray, kind: type[Disturbed]
) -> None:
    """Of a team only the agent; of a joint actor all that sees the same entries."""
    agent, spread = BAR.agents[0], np.arange(1.0, len(BAR.state) + 1)
    clean = acted(Means(BAR, True), states)
    team, joint = (
        acted(disturbed(kind, Means(BAR, joint), agent, 0.5, spread), states)
        for joint in (False, True)
    )
    own = list(agent.action)
    assert (team[:, own] == joint[:, own]).all()
    assert (team[:, own] != clean[:, own]).any()
    assert_others_equal(team, clean, agent)
    assert (joint != clean).any(axis=0).all(), "all see some of what this agent sees"


def test_noise_has_the_spread_of_each_entry_and_no_other_entry_has_any() -> None:
    agent, spread = BAR.agents[1], np.arange(1.0, len(BAR.state) + 1)
    seen: list[np.ndarray] = []

    class Shown(Means):
        def act(self, state: np.ndarray) -> np.ndarray:
            seen.append(state)
            return super().act(state)

    policy = disturbed(Noisy, Shown(BAR, True), agent, 0.1, spread)
    acted(policy, np.zeros((4_000, len(BAR.state))))
    deviation = np.std(seen, axis=0)
    sees = list(agent.observation)
    assert deviation[sees] == pytest.approx(0.1 * spread[sees], rel=0.05)
    deviation[sees] = 0.0
    assert not deviation.any()


def test_agents_of_another_run_are_its_own(states: np.ndarray) -> None:
    class Fewer(Means):
        def act(self, state: np.ndarray) -> np.ndarray:
            return super().act(state) / 2

    agent = BAR.agents[3]
    one, other = Means(BAR, False), Fewer(BAR, True)
    mixed = acted(Mixed(one, {agent.name: other}), states)
    own = list(agent.action)
    assert (mixed[:, own] == acted(other, states)[:, own]).all()
    assert_others_equal(mixed, acted(one, states), agent)


def test_a_policy_that_cannot_be_copied_takes_no_agents_place() -> None:
    policy: Any = Means(BAR, True)
    policy.lock = Lock()
    with pytest.raises(UsageError, match=r"means cannot be copied .*lock"):
        Mixed(Means(BAR, False), {BAR.agents[3].name: policy})
