"""Flows that teach: conventions, one-step students, the best of n, chunks."""

from typing import Any

import numpy as np
import pytest
import torch

from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.errors import UsageError
from tests.algorithms.games import learner_of, learnt, played, steps_of, team
from tests.algorithms.test_teams import XOR, conventions, kept

PLANS = np.array([[1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0]])
"""Actions of two steps; their sum pays if it is 0."""


@pytest.fixture(scope="module")
def mac_flow() -> Any:
    """MAC-Flow on two conventions, the first worth a little more."""
    return learner_of("mac-flow", conventions((1.0, 0.9)), updates=1_500)


@pytest.mark.slow
def test_a_joint_teacher_keeps_to_conventions(mac_flow: Any) -> None:
    teacher = LearnedPolicy("teacher", mac_flow.flow.agents(0), mac_flow.layout)
    assert kept(played(teacher)) > 0.85


@pytest.mark.slow
def test_students_of_a_joint_teacher_learn_its_mean_over_what_they_do_not_know(
    mac_flow: Any,
) -> None:
    """By hand, where the teacher's way depends on which noise is the larger.

    Of an agent's own noise alone its mean is 2 Phi(z) - 1, uniform in [-1, 1]. Two of
    them agree on a sign by chance, and are near one of the conventions in 2 x 0.15^2.
    """
    students = LearnedPolicy("students", mac_flow.agents(0), mac_flow.layout)
    acted = played(students, 400)[:, 0]
    np.testing.assert_allclose(acted.std(axis=0), 1 / np.sqrt(3), atol=0.12)
    assert 0.4 < np.mean(acted[:, 0] * acted[:, 1] < 0) < 0.6
    assert kept(acted[:, None]) < 0.12


@pytest.mark.slow
def test_a_student_matches_two_modes_in_one_step() -> None:
    """Their mean, which an actor without noise learns, is none of them."""
    actions = np.where(np.arange(200) < 100, 1.0, -1.0)[:, None]
    policy = learnt("fql", steps_of(actions, np.ones(200), team(1)), updates=1_000)
    assert not policy.agents["joint"].actor.form.flow_steps
    acted = played(policy)[:, 0, 0]
    assert np.mean(np.abs(np.abs(acted) - 1) < 0.3) > 0.7
    assert 0.35 < np.mean(acted > 0) < 0.65


@pytest.mark.slow
def test_students_of_the_best_of_n_all_choose_the_better_convention() -> None:
    """Whichever it is."""
    settings: Any = {"seeds": (0, 1), "samples": 8, "flow_steps": 5}
    for rewards, better in (((1.0, 0.9), XOR[0]), ((0.9, 1.0), XOR[1])):
        learner = learner_of("best-of-n", conventions(rewards), 800, **settings)
        for number in (0, 1):
            policy = LearnedPolicy("x", learner.agents(number), learner.layout)
            acted = played(policy, episodes=2)[:, 0]
            assert np.array_equal(acted[0], acted[1])  # it draws nothing
            np.testing.assert_allclose(acted[0], better, atol=0.3)


def test_the_best_is_the_one_of_highest_least_value() -> None:
    learner = learner_of("best-of-n", conventions(), updates=3, samples=5)
    drawn = np.random.default_rng(0).standard_normal((1, 7, 12), np.float32)
    state, noise = torch.from_numpy(drawn[..., :2]), torch.from_numpy(drawn[..., 2:])
    picked = learner._picked(state, noise)
    proposed = [
        learner.flow.joint(state, noise[..., i : i + 2]) for i in range(0, 10, 2)
    ]
    target = learner._parts["target_critics"]
    values = [target.values(state, action).amin(dim=(1, 2)) for action in proposed]
    best = torch.stack(values).argmax(dim=0)[0]
    assert len(set(best.tolist())) > 1
    for row, number in enumerate(best):
        torch.testing.assert_close(picked[0, row], proposed[int(number)][0, row])


# --- Chunks ------------------------------------------------------------------


def plans() -> EpisodeArrays:
    """All plans of two steps as often; the last step pays 1 if their sum is 0."""
    chosen = np.arange(200) % 4
    rewards = np.zeros((200, 2))
    rewards[:, 1] = chosen < 2
    return steps_of(PLANS[chosen].reshape(-1, 1), rewards.ravel(), team(1), length=2)


@pytest.mark.slow
def test_a_plan_of_several_steps_agrees_with_itself() -> None:
    """Its second action does not look, and yet is the opposite of the first."""
    settings: Any = {"distillation": 0.3, "flow_steps": 5}
    policy = learnt("q-chunking", plans(), 1_000, chunk=2, **settings)
    acted = played(policy, states=((0.0, 0.0), (1.0, 0.0)))[..., 0]
    assert np.mean(acted[:, 0] * acted[:, 1] < 0) > 0.9
    assert 0.25 < np.mean(acted[:, 0] > 0) < 0.75
    blind = played(policy, states=((0.0, 0.0), (-9.0, 9.0)))[..., 0]
    assert np.array_equal(acted, blind)
    then = played(policy, 5, states=((0.0, 0.0), (1.0, 0.0), (0.0, 0.0)))[..., 0]
    assert (then[:, 2] != then[:, 0]).all()  # a new plan


@pytest.mark.slow
def test_values_of_chunks_are_discounted_sums() -> None:
    """By hand: rewards 1, 2, 4 of three steps, half as much a step later."""
    rewards = np.tile([1.0, 2.0, 4.0], 20)
    data = steps_of(np.zeros((60, 1)), rewards, team(1), length=3)
    settings: Any = {"target_rate": 0.05, "distillation": 100.0}
    learner = learner_of("q-chunking", data, 800, chunk=2, discount=0.5, **settings)
    state = learner.normalizer(torch.tensor([[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]]))
    found = learner.critics.first(state, torch.zeros(1, 3, 2))[0]
    by_hand = torch.tensor([1 + 2 / 2 + 4 / 4, 2 + 4 / 2, 4.0])
    torch.testing.assert_close(found, by_hand, atol=0.3, rtol=0.0)


def test_nothing_beyond_an_episode_is_imitated() -> None:
    """Of episodes of one step, a flow of three learns its first action only."""
    data = steps_of(np.full((50, 1), 0.5), np.ones(50), team(1))
    ends = [
        learner_of("q-chunking", data, updates).flow.agents(0)["joint"].actor.layers[-1]
        for updates in (0, 5)
    ]
    moved = ends[0].bias != ends[1].bias
    assert moved.tolist() == [True, False, False]


def test_chunks_keep_their_goals() -> None:
    shares: Any
    for shares in ({"future": 0.1}, {"elsewhere": 0.1}):
        with pytest.raises(UsageError, match="expected 0: chunks of several steps"):
            learner_of("q-chunking", plans(), 0, **shares)
        learner_of("q-chunking", plans(), 0, chunk=1, **shares)


@pytest.mark.parametrize("name", ["flow-bc", "ma-flow-bc"])
def test_a_flow_acts_as_its_network_says(name: str) -> None:
    """In NumPy, for one observation; also when its weights have changed since."""
    learner = learner_of(name, conventions(), 100)
    rng = np.random.default_rng(0)
    agents = learner.agents(0).values()
    for scale in (1.0, 0.7):
        for agent in agents:
            seen = len(agent.layout.observation)
            observation = rng.normal(size=seen).astype(np.float32)
            noise = rng.normal(size=agent.actor.noise).astype(np.float32)
            with torch.no_grad():
                for parameter in agent.actor.layers.parameters():
                    parameter *= scale
                own = agent.actor(torch.tensor(observation), torch.tensor(noise))
                expected = agent.planned(own).numpy()
            planned = agent.plan(observation, noise)
            np.testing.assert_allclose(planned, expected, atol=1e-6)
            assert planned.dtype == np.float32


def test_an_episode_begins_with_a_plan_of_its_own() -> None:
    """Also where the last one ended in the middle of a plan."""
    learner = learner_of("q-chunking", plans(), 1, chunk=2)
    policy = LearnedPolicy("x", learner.agents(0), learner.layout)
    begun = []
    for steps in (1, 2, 3):
        policy.begin(np.random.default_rng(0), policy.layout)
        first, *_ = [policy.act(np.zeros(2)) for _ in range(steps)]
        begun.append(first)
    assert np.array_equal(begun[0], begun[1]) and np.array_equal(begun[0], begun[2])
