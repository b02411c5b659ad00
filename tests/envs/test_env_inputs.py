"""What environments refuse, and what they show."""

import copy
import pickle
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from marl_mm.envs import parallel_env
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.goal_env import GoalEnv
from marl_mm.envs.parallel_vector import TeamVector
from marl_mm.envs.registry import TASKS, register_task
from marl_mm.envs.task import Attempt, Terms, Values
from marl_mm.envs.tasks.reach import Reach
from marl_mm.envs.vector import GoalVector
from marl_mm.errors import InvalidActionError, LayoutError, MarlMmError, UsageError

REACHING = [name for name, task in TASKS.items() if isinstance(task, Reach)]


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(3), r"shape \(3,\), expected \(4,\)"),
        (np.array([0, np.nan, 0, 0.5]), "finite"),
        (np.array([0, np.inf, 0, 0.5]), "finite"),
        (np.array(["a", "b", "c", "d"]), "expected numbers"),
    ],
)
def test_bad_actions_are_refused(
    core: EpisodeCore, action: np.ndarray, message: str
) -> None:
    core.reset(np.random.default_rng(0))
    with pytest.raises(InvalidActionError, match=message):
        core.step(action)


@pytest.mark.parametrize("task", REACHING)
def test_bad_agent_actions_are_refused(task: str) -> None:
    env = parallel_env(task, overrides={"ticks_per_step": 24})
    env.reset(seed=0)
    right = np.zeros(env.action_space("end_effector").shape)
    with pytest.raises(InvalidActionError, match="no action for agent 'balance'"):
        env.step({"end_effector": right})
    with pytest.raises(InvalidActionError, match=r"'balance' has shape \(2,\)"):
        env.step({"end_effector": right, "balance": np.zeros(2)})
    others: list[Any] = [np.zeros(4), None, [right, np.zeros(1)]]
    for joint in others:
        with pytest.raises(InvalidActionError, match="expected each agent's by its"):
            env.step(joint)
    with pytest.raises(InvalidActionError, match=r"'end_effector' has shape \(2,\)"):
        env.step({"end_effector": np.zeros(2), "balance": np.zeros(1)})
    env.close()


def test_step_before_reset_and_bad_goals_are_refused(core: EpisodeCore) -> None:
    with pytest.raises(UsageError, match="before reset"):
        core.step(np.zeros(4))
    with pytest.raises(UsageError, match="3 finite numbers: goal_x"):
        core.reset(np.random.default_rng(0), np.array([1.0, np.nan, 0.5]))


def test_after_a_refused_goal_there_is_no_episode_to_go_on_with() -> None:
    class Refuses(Reach):
        def begin(self, attempt: Any, rng: Any, goal: Any) -> None:
            super().begin(attempt, rng, goal)
            if goal is not None:
                raise UsageError("no")

    core = EpisodeCore(Refuses(max_steps=1))
    core.reset(np.random.default_rng(0))
    with pytest.raises(UsageError, match="no"):
        core.reset(np.random.default_rng(0), np.zeros(3))
    with pytest.raises(UsageError, match="before reset"):
        core.step(np.zeros(4))
    core.close()


@pytest.mark.parametrize("make", [GoalEnv, parallel_env, GoalVector, TeamVector])
def test_environments_are_not_copied_or_pickled(make: Any) -> None:
    """A copy would drive the robot of the first."""
    env = make("Reach-v0")
    for twin in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(UsageError, match="cannot be copied or pickled"):
            twin(env)
    env.close()


class HeightFirst(Reach):
    """Its goal has another order than the state."""

    layout = replace(Reach.layout, desired=("goal_z", "goal_x", "goal_y"))


def test_what_a_goal_should_be_is_told_in_its_own_order() -> None:
    core = EpisodeCore(HeightFirst(max_steps=1))
    with pytest.raises(UsageError, match=r"goal_z .*, goal_x .*, goal_y"):
        core.reset(np.random.default_rng(0), np.zeros(2))
    core.close()


class NeedsYaw(Reach):
    """Its reward depends on an entry of the state, which info tells for hindsight."""

    needs = (*Reach.needs, "base_yaw")

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        return np.asarray(super().reward(achieved, desired, terms) - terms["base_yaw"])


def test_rewards_of_a_state_entry_are_computed_again(registries: None) -> None:
    register_task("NeedsYaw-v0", NeedsYaw(max_steps=2))
    env = GoalEnv("NeedsYaw-v0")
    env.reset(seed=0)
    seen, reward, _, _, info = env.step(np.ones(4, np.float32))
    assert info["base_yaw"] == seen["observation"][5] != 0.0
    again = env.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
    assert again == reward
    env.close()


@dataclass(frozen=True, kw_only=True)
class Pays(Reach):
    """Its reward is what it is told."""

    paid: Any = None

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        reward: np.ndarray = self.paid
        return reward


@pytest.mark.parametrize("paid", [np.array(np.nan), np.zeros(3), "much", None])
def test_a_reward_that_is_no_number_ends_the_episode_at_once(paid: Any) -> None:
    core = EpisodeCore(Pays(max_steps=2, paid=paid))
    core.reset(np.random.default_rng(0))
    with pytest.raises(MarlMmError, match=r"Pays\.reward is .*, expected (one|a f)"):
        core.step(np.zeros(4))
    core.close()


@dataclass(frozen=True, kw_only=True)
class Sees(Reach):
    """One entry of its state is what it is told."""

    seen: Any = None

    def observe(self, attempt: Attempt) -> Values:
        return {**super().observe(attempt), "base_yaw": self.seen}


@pytest.mark.parametrize("seen", [np.zeros(3), np.zeros(1), "far"])
def test_an_entry_that_is_no_number_is_named(seen: Any) -> None:
    core = EpisodeCore(Sees(seen=seen))
    with pytest.raises(LayoutError, match=r"Sees\.observe: base_yaw is .*, expected"):
        core.reset(np.random.default_rng(0))
    with pytest.raises(UsageError, match="reset"):  # there is no episode to go on with
        core.step(np.zeros(4))
    core.close()


@pytest.mark.parametrize(
    ("function", "returned", "complaint"),
    [
        ("act", None, "act returned None, expected a list with an Order for each of 1"),
        ("observe", None, r"observe is None, expected a dict"),
        ("measure", None, r"measure is None, expected a dict"),
        ("measure", {"d_mm": "far", "d_mp": 0.0}, "measure: d_mm, .* is 'far', exp"),
        (
            "measure",
            {"d_mm": np.zeros(3), "d_mp": 0.0},
            "measure: d_mm, which own_info",
        ),
        ("measure", {}, "needs has d_mm, d_mp, which neither measure returns nor"),
        ("failure", True, "failure is True, expected words, or '' if there is"),
        (
            "reached",
            np.zeros(3, bool),
            "reached is array.*, expected one value for one",
        ),
        ("act", [None], "act returned .*, expected a list with an Order"),
        (
            "measure",
            {"d_mm": np.nan, "d_mp": 0.0},
            "measure: d_mm, .* is nan, exp",
        ),
        ("distance", np.array(np.inf), r"distance is array\(inf\), expected a finite"),
        ("reached", np.nan, "reached is nan, expected a finite"),
    ],
)
def test_a_function_of_a_task_that_returns_something_odd_is_named(
    function: str, returned: Any, complaint: str
) -> None:
    odd = type("Odd", (Reach,), {function: lambda self, *arguments: returned})
    core = EpisodeCore(odd(max_steps=2))
    with pytest.raises(MarlMmError, match=rf"Odd\.{complaint}"):
        core.reset(np.random.default_rng(0))
        core.step(np.zeros(4))
    core.close()


def test_bad_render_modes_and_early_states_are_refused() -> None:
    for make in (GoalEnv, parallel_env):
        with pytest.raises(UsageError, match="expected rgb_array or None"):
            make(render_mode="ascii")
    env = parallel_env("Reach-v0")
    for early in (env.state, lambda: env.step({})):
        with pytest.raises(UsageError, match="before reset"):
            early()
    env.close()
