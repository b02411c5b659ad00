"""Layouts: what they refuse, and that every one travels."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from marl_mm.algorithms.actors import AgentActor, blank_actor, joint_action
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.hdf5 import FILE, read_hdf5
from marl_mm.datasets.location import locate
from marl_mm.datasets.plausible import problems_of
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.datasets.storage import write_dataset
from marl_mm.envs.goal_env import goal_observation
from marl_mm.envs.parallel import join_actions, split_action, split_state
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.errors import LayoutError
from marl_mm.layout import Agent, Entry, Layout, columns
from marl_mm.spaces import action_space, state_space

HAND, BALANCE = REACH.team


@st.composite
def layouts(draw: Callable[[Any], Any]) -> Layout:
    """Layouts of 1 to 8 agents with overlapping views and goals of 1 to 3 entries."""
    team = draw(st.integers(1, 8))
    goal = draw(st.integers(1, 3))
    rest = draw(st.integers(goal, 9))
    state = [f"seen_{i}" for i in range(rest)] + [f"wanted_{i}" for i in range(goal)]
    state = draw(st.permutations(state))
    bounds = st.sampled_from([(-np.inf, np.inf), (0.0, 1.0), (-2.0, np.inf)])
    action = [f"set_{i}" for i in range(team + draw(st.integers(0, 4)))]
    names = st.text("abcdefghXYZ_", min_size=1, max_size=6)
    agents = draw(st.lists(names, min_size=team, max_size=team, unique=True))
    owners = draw(st.permutations(action))
    cuts = sorted(draw(st.permutations(range(1, len(action))))[: team - 1])
    parts = np.split(np.array(owners), cuts)
    return Layout(
        tuple(Entry(name, "m", *draw(bounds)) for name in state),
        tuple(Entry(name, "1", -1.0, 1.0 + i) for i, name in enumerate(action)),
        tuple(
            Agent(
                name,
                tuple(draw(st.lists(st.sampled_from(state), min_size=1, unique=True))),
                tuple(part.tolist()),
            )
            for name, part in zip(agents, parts, strict=True)
        ),
        tuple(draw(st.permutations([n for n in state if n[0] == "s"]))[:goal]),
        tuple(draw(st.permutations([n for n in state if n[0] == "w"]))),
    )


def random_episode(layout: Layout, seed: int, steps: int = 4) -> Episode:
    """An episode of random numbers within the layout's bounds."""
    rng = np.random.default_rng(seed)
    low, high = np.array([(e.low, e.high) for e in layout.state]).T
    states = rng.uniform(
        np.maximum(low, -5), np.minimum(high, 5), (steps + 1, len(low))
    )
    states[:, layout.goal] = states[0, layout.goal]
    actions = rng.uniform(layout.low, layout.high, (steps, len(layout.action)))
    ends = np.arange(steps) == steps - 1
    return Episode(
        states=states,
        actions=actions.astype(np.float32),
        rewards=rng.normal(size=steps),
        terminated=ends,
        truncated=ends & False,
        info={"own": rng.normal(size=steps), "is_success": ends * 1.0},
        seed=seed,
        index=seed,
        source="dice",
        start=rng.normal(size=11),
        layout=layout,
    )


@pytest.mark.slow
@given(layouts())
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
def test_a_dataset_of_any_layout_comes_back_equal(
    tmp_path_factory: pytest.TempPathFactory, layout: Layout
) -> None:
    """Through HDF5 and through the cache, with every agent's view.

    The file is read in this process: a process for each example would take a minute.
    """
    folder = tmp_path_factory.mktemp("any")
    location = locate(str(folder / "any-v0"))
    episodes = [random_episode(layout, seed) for seed in range(3)]
    arrays = arrays_of(episodes, location.id)
    write_dataset(location, arrays, Provenance(task="Reach-v0", collector="dice"))
    cached = load_dataset(location)
    path = location.data / FILE
    stored = read_hdf5(path, len(arrays), layout, list(arrays.info))
    assert problems_of(stored) == []
    for back in (cached, replace(cached, arrays=stored)):
        assert back.arrays.layout == layout
        for here, there in zip(episodes, back.episodes, strict=True):
            np.testing.assert_array_equal(here.states, there.states)
            np.testing.assert_array_equal(here.actions, there.actions)
            assert there.layout == layout and there.info.keys() == here.info.keys()
        joined = np.zeros_like(arrays.actions)
        for agent, view in zip(layout.agents, back.agents().values(), strict=True):
            joined[:, list(agent.action)] = view.action
            names = [layout.state_names[i] for i in agent.observation]
            np.testing.assert_array_equal(
                view.observation, back.joint().observation[:, layout.columns(*names)]
            )
        np.testing.assert_array_equal(joined, arrays.actions)


@given(layouts())
@settings(max_examples=60, deadline=None)
def test_any_layout_travels_as_json_and_through_every_form(layout: Layout) -> None:
    assert Layout.from_json(json.loads(json.dumps(layout.to_json()))) == layout
    episode = random_episode(layout, 0)
    state, action = episode.states[0], episode.actions[0]
    goal = goal_observation(state, layout)
    again = layout.state_of(goal["observation"], goal["desired_goal"])
    np.testing.assert_array_equal(again, state)
    assert goal["achieved_goal"].shape == goal["desired_goal"].shape
    joined = join_actions(split_action(action, layout), layout)
    np.testing.assert_array_equal(joined, action)
    batch = split_action(np.stack([action] * 3), layout)
    np.testing.assert_array_equal(join_actions(batch, layout, 3), [action] * 3)
    assert [part.shape for part in split_state(state, layout).values()] == [
        (len(agent.sees),) for agent in layout.team
    ]
    assert state_space(layout).contains(state)
    assert action_space(layout).contains(action)


@given(layouts(), st.integers(0, 2**31))
@settings(max_examples=30, deadline=None)
def test_every_agent_acts_on_what_it_sees_alone(layout: Layout, seed: int) -> None:
    actors: dict[str, AgentActor] = {
        agent.name: blank_actor(agent, [4]) for agent in layout.agents
    }
    policy = LearnedPolicy("any", actors, layout)
    policy.begin(np.random.default_rng(0), layout)
    state = random_episode(layout, seed).states[0]
    action = policy.act(state)
    alone = policy.act_agents(split_state(state, layout))
    np.testing.assert_array_equal(join_actions(alone, layout), action)
    for agent in layout.agents:
        other = state + 1.0
        other[list(agent.observation)] = state[list(agent.observation)]
        sets = list(agent.action)
        np.testing.assert_array_equal(policy.act(other)[sets], action[sets])
    states = torch.tensor(random_episode(layout, seed).states, dtype=torch.float32)
    joint = joint_action(actors, states)
    for agent in layout.agents:
        network, seen = actors[agent.name].actor, states[:, list(agent.observation)]
        assert torch.equal(joint[:, list(agent.action)], network(seen))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"team": ()}, "agents has no entries"),
        ({"team": (HAND,)}, "expected each of delta_x, delta_y, delta_z, alpha once"),
        ({"team": (HAND, HAND)}, "agents has 'end_effector' twice"),
        (
            {"team": (HAND, replace(BALANCE, sets=("alpha", "delta_x")))},
            "once",
        ),
        (
            {"team": (HAND, replace(BALANCE, sees=("base_x", "wind")))},
            "'balance' sees wind, which the state lacks",
        ),
        ({"team": (HAND, replace(BALANCE, name="joint"))}, "expected another name"),
        ({"team": (HAND, replace(BALANCE, name="rewards"))}, "expected another name"),
        ({"team": (HAND, replace(BALANCE, sees=()))}, "sees or sets no entry"),
        ({"team": (HAND, replace(BALANCE, name="a/b"))}, "the name 'a/b'"),
        ({"desired": ("goal_x", "goal_y", "wind")}, "desired has wind"),
        ({"desired": ("goal_x", "goal_y")}, "expected as many entries"),
        ({"compared": (), "desired": ()}, "compared has no entries"),
        ({"compared": REACH.desired}, "goal_x, goal_y, goal_z would be compared with"),
        ({"state": (*REACH.state, Entry("x", "m", 1.0, 1.0))}, "expected low < high"),
        ({"state": (*REACH.state, REACH.state[0])}, "'end_effector_x' twice"),
        ({"state": (*REACH.state, Entry("x", "m", 1.0, 0.0))}, "expected low < high"),
        ({"action": (*REACH.action[:3], Entry("alpha"))}, "expected finite low < high"),
        ({"state": (*REACH.state, Entry("x", "a\nb"))}, r"'x' has the unit 'a\\nb'"),
        ({"state": (*REACH.state, Entry("x", 0.0, 1.0))}, "'x' has the unit 0.0, exp"),  # type: ignore[arg-type]
        ({"team": ("hand", BALANCE)}, "team has 'hand', expected objects of Agent"),
        (
            {"state": (*REACH.state, *(Entry(f"beam_{i}") for i in range(1000)))},
            "state has 1,010 entries, expected at most 1,000",
        ),
    ],
)
def test_layouts_that_make_no_sense_are_refused(
    change: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(LayoutError, match=complaint):
        replace(REACH, **change)


def test_a_layout_of_lists_is_one_of_tuples() -> None:
    lists: dict[str, Any] = {
        "state": list(REACH.state),
        "action": list(REACH.action),
        "team": [Agent(a.name, [*a.sees], [*a.sets]) for a in REACH.team],  # type: ignore[arg-type]
        "compared": list(REACH.compared),
        "desired": list(REACH.desired),
    }
    assert Layout(**lists) == REACH and hash(Layout(**lists)) == hash(REACH)


def test_nine_agents_are_too_many() -> None:
    action = tuple(Entry(f"set_{i}", "1", 0.0, 1.0) for i in range(9))
    team = tuple(Agent(f"a{i}", ("base_x",), (f"set_{i}",)) for i in range(9))
    with pytest.raises(LayoutError, match="9 agents, expected at most 8"):
        replace(REACH, action=action, team=team)
    assert len(replace(REACH, action=action[:8], team=team[:8]).agents) == 8


def test_columns_are_views_where_they_can_be() -> None:
    assert columns((2, 3, 4)) == slice(2, 5)
    assert columns((2, 4)) == [2, 4] and columns((3, 2)) == [3, 2]
    state = np.arange(10.0)
    assert state[REACH.columns("goal_x", "goal_y")].base is state
    with pytest.raises(LayoutError, match="columns are asked for of wind, which"):
        REACH.columns("wind")


@pytest.mark.parametrize("values", [{}, {"state": 3}, {"state": [["x"]]}, 7, None])
def test_what_is_no_layout_is_said_to_be_none(values: Any) -> None:
    with pytest.raises(LayoutError, match="no layout"):
        Layout.from_json(values)


def test_episodes_of_two_layouts_are_no_dataset(tmp_path: Path) -> None:
    turned = replace(REACH, state=REACH.state[::-1])
    straight, reversed_ = (random_episode(layout, 0) for layout in (REACH, turned))
    with pytest.raises(Exception, match="order of the state"):
        arrays_of([straight, reversed_], "x")


def test_actions_at_bounds_that_are_no_float32_are_within_them() -> None:
    """float32(0.6) is above 0.6; a step beyond is outside all the same."""
    arrays = shipped_arrays().select(range(2))
    layout = replace(
        arrays.layout,
        action=tuple(replace(e, low=-0.6, high=0.6) for e in arrays.layout.action),
    )
    at_bounds = np.full_like(arrays.actions, 0.6)
    assert problems_of(replace(arrays, layout=layout, actions=at_bounds)) == []
    beyond = np.nextafter(at_bounds, np.float32(1))
    (problem,) = problems_of(replace(arrays, layout=layout, actions=beyond))
    assert "outside of the action space" in problem
