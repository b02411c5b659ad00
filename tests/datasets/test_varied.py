"""The varied collector: teams of experts that do otherwise."""

from typing import Any

import numpy as np
import pytest

from marl_mm.collectors.scripted import ScriptedPolicy
from marl_mm.collectors.varied import VariedConfig, VariedPolicy
from marl_mm.envs.registry import TASKS
from marl_mm.envs.task import ScriptConfig
from marl_mm.envs.tasks.gate import Gate
from marl_mm.errors import LayoutError, UsageError


def acts(task: str, states: np.ndarray, seed: int = 0, **settings: Any) -> np.ndarray:
    kind = TASKS.get(task)
    policy = VariedPolicy(VariedConfig(**settings), kind)
    policy.begin(np.random.default_rng(seed), kind.layout)
    return np.stack([policy.act(state) for state in states])


def states_of(task: str, number: int = 12) -> np.ndarray:
    layout = TASKS.get(task).layout
    states = np.random.default_rng(1).uniform(0.2, 0.8, (number, len(layout.state)))
    return states


@pytest.mark.parametrize("task", ["Reach-v0", "Grasp-v0", "Tray-v0", "Bar-v0"])
def test_without_settings_it_is_the_script(task: str) -> None:
    states = states_of(task)
    script = ScriptedPolicy(ScriptConfig(), TASKS.get(task))
    script.begin(np.random.default_rng(0), TASKS.get(task).layout)
    expected = np.stack([script.act(state) for state in states])
    np.testing.assert_array_equal(acts(task, states), expected)


def test_noise_has_its_size_and_its_memory() -> None:
    task, states = "Reach-v0", np.repeat(states_of("Reach-v0", 1), 4000, axis=0)
    states[:, 7:] = states[:, :3]  # at the goal: the script stands still
    for memory in (0.0, 0.8):
        noise = acts(task, states, noise=0.1, noise_memory=memory)[:, :3]
        assert noise.std() == pytest.approx(0.1, rel=0.1)
        shift = (noise[1:] * noise[:-1]).mean() / noise.var()
        assert shift == pytest.approx(memory, abs=0.06)


def test_an_agent_at_random_leaves_the_others_alone() -> None:
    task, states = "Reach-v0", states_of("Reach-v0")
    script = acts(task, states)
    for agent, own in (("balance", [3]), ("end_effector", [0, 1, 2])):
        varied = acts(task, states, random_agents=(agent,))
        rest = [i for i in range(4) if i not in own]
        np.testing.assert_array_equal(varied[:, rest], script[:, rest])
        assert (varied[:, own] != script[:, own]).any(axis=1).all()


def test_one_agent_is_bad_in_each_episode_and_each_is_sometimes() -> None:
    task, states = "Reach-v0", states_of("Reach-v0")
    script, bad = acts(task, states), set()
    for seed in range(12):
        varied = acts(task, states, seed, one_random=True) != script
        hand, balance = varied[:, :3].any(), varied[:, 3].any()
        assert hand != balance
        bad.add(bool(hand))
    assert bad == {True, False}


def test_conventions_are_drawn_for_the_whole_team() -> None:
    task, states = "Bar-v0", states_of("Bar-v0")
    both = {name: acts(task, states, convention=name) for name in ("over", "under")}
    assert not np.array_equal(both["over"], both["under"])
    drawn = [acts(task, states, seed, any_convention=True) for seed in range(12)]
    which = [np.array_equal(actions, both["over"]) for actions in drawn]
    under = [np.array_equal(actions, both["under"]) for actions in drawn]
    assert set(which) == {True, False} and [not w for w in which] == under
    mixed = acts(task, states, conventions=("over", "under"))
    np.testing.assert_array_equal(mixed[:, :4], both["over"][:, :4])
    np.testing.assert_array_equal(mixed[:, 4:], both["under"][:, 4:])


def test_late_and_blind_agents_act_by_less() -> None:
    task, states = "Tray-v0", states_of("Tray-v0")
    script = acts(task, states)
    late = acts(task, states, late_agents=("balance",))
    np.testing.assert_array_equal(late[1:, 3], script[:-1, 3])
    np.testing.assert_array_equal(late[:, :3], script[:, :3])
    blind = acts(task, states, blind_agents=("balance",))
    assert len(set(blind[:, 3].tolist())) == 1
    held = acts(task, states, held_alpha=0.25)
    np.testing.assert_array_equal(held[:, 3], 0.25)


@pytest.mark.parametrize("policy", [ScriptedPolicy, VariedPolicy])
def test_an_expert_that_leaves_out_an_entry_is_named(policy: Any) -> None:
    task = type("Bare", (Gate,), {"expert": lambda *_: {"delta_x": 1.0}})()
    actor = policy(VariedConfig(), task)
    actor.begin(np.random.default_rng(0), task.layout)
    with pytest.raises(
        LayoutError, match=r"Bare\.expert returns no delta_y, delta_z, a"
    ):
        actor.act(np.zeros(len(task.layout.state)))


@pytest.mark.parametrize(
    ("task", "settings", "error"),
    [
        ("Reach-v0", {"noise": -1.0}, "noise is -1.0, expected >= 0"),
        ("Reach-v0", {"noise_memory": 1.0}, "expected 0 to below 1"),
        ("Reach-v0", {"held_alpha": 1.5}, "held_alpha is 1.5, expected 0 to 1"),
        ("Reach-v0", {"random_agents": ("hand",)}, "no agent 'hand', expected end_ef"),
        ("Reach-v0", {"any_convention": True}, "Reach has no conventions"),
        ("Bar-v0", {"conventions": ("over",)}, "one for each of 2 robots"),
        ("Bar-v0", {"conventions": ("over", "ovr")}, "'ovr', expected over or under"),
        ("Reach-v0", {"noise_memory": 0.5}, "but noise is 0, so that it has no effect"),
        (
            "Bar-v0",
            {"convention": "over", "any_convention": True},
            "convention and any_convention are given, expected one of them",
        ),
        ("Reach-v0", {"blind_agents": ("balance",)}, "'balance' cannot be blind"),
        ("QuietZone-v0", {"blind_agents": ("end_effector",)}, "cannot be blind"),
    ],
)
def test_settings_that_make_no_sense_are_refused(
    task: str, settings: dict[str, Any], error: str
) -> None:
    with pytest.raises(UsageError, match=error):
        VariedPolicy(VariedConfig(**settings), TASKS.get(task))


def test_noise_is_in_halves_of_each_actions_range() -> None:
    """Alpha's range is half as wide as that of a displacement."""
    states = np.repeat(states_of("Reach-v0", 1), 4000, axis=0)
    states[:, 7:] = states[:, :3]  # at the goal: the script stands still
    noise = acts("Reach-v0", states, noise=0.02, random_agents=(), held_alpha=0.5)
    np.testing.assert_allclose(noise.std(axis=0), [0.02, 0.02, 0.02, 0.01], rtol=0.1)


def test_every_balance_agent_holds_its_alpha() -> None:
    held = acts("Bar-v0", states_of("Bar-v0"), held_alpha=0.25)
    script = acts("Bar-v0", states_of("Bar-v0"))
    changed = (held != script).any(axis=0)
    assert changed.sum() == 2 and (held[:, changed] == 0.25).all()
