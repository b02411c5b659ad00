"""Reward and success, worked by hand and vectorised."""

import numpy as np
import pytest

from marl_mm.envs.config import ReachConfig, reach_config
from marl_mm.envs.terms import goal_distance, reach_reward, reached
from marl_mm.errors import UsageError


def test_reward_by_hand() -> None:
    """r = -0.3 - 5 * 0.02 - 5 * 0.01."""
    args = (np.array(0.3), np.array(0.02), np.array(0.01), np.array(7.0))
    assert reach_reward(*args, ReachConfig()) == pytest.approx(-0.45)
    smooth = reach_config("SmoothReach-v0")
    assert reach_reward(*args, smooth) == pytest.approx(-0.45 - 0.2 * 7)


def test_reaching_pays_ten_instead_of_the_distance() -> None:
    zero = np.array(0.0)
    reward = reach_reward(np.array(0.049), zero, zero, zero, ReachConfig())
    assert reward == pytest.approx(10.0)


def test_success_is_strict_and_depends_on_the_task() -> None:
    distance = np.array([0.019, 0.02, 0.049, 0.05])
    assert reached(distance, ReachConfig()).tolist() == [True, True, True, False]
    precise = reach_config("PreciseReach-v0")
    assert reached(distance, precise).tolist() == [True, False, False, False]


def test_terms_are_vectorised() -> None:
    achieved = np.zeros((4, 5, 3))
    desired = np.full((4, 5, 3), 2.0)
    distance = goal_distance(achieved, desired)
    assert distance.shape == (4, 5)
    ones = np.ones((4, 5))
    reward = reach_reward(distance, ones, ones, ones, ReachConfig())
    np.testing.assert_allclose(reward, -np.sqrt(12) - 10)


def test_overrides_reach_nested_fields() -> None:
    config = reach_config(
        "Reach-v0", {"max_steps": 50, "controller": {"gains": {"ee_rate": 4.0}}}
    )
    assert config.max_steps == 50
    assert config.controller.gains.ee_rate == 4.0
    assert config.controller.gains.ee_speed == 0.5


def test_overrides_take_json_lists() -> None:
    config = reach_config("Reach-v0", {"goal_y": [-0.1, 0.1]})
    assert config.goal_y == (-0.1, 0.1)


@pytest.mark.parametrize(
    ("task", "overrides", "message"),
    [
        ("Fly-v0", {}, "Reach-v0, SmoothReach-v0, PreciseReach-v0"),
        ("Reach-v0", {"maxsteps": 3}, "max_steps"),
        ("Reach-v0", {"controller": {"gain": 3}}, "controller.gain"),
        ("Reach-v0", {"max_steps": 0}, "expected >= 1"),
        ("Reach-v0", {"max_steps": "50"}, "max_steps is '50', expected int"),
        ("Reach-v0", {"cruise": float("nan")}, "cruise is nan, expected a finite"),
        ("Reach-v0", {"goal_y": [0.2]}, "expected 2 numbers"),
        ("Reach-v0", {"action_scale": -1}, "expected > 0"),
        ("Reach-v0", {"controller": 5}, "expected a mapping of its fields"),
        ("Reach-v0", {"controller": {"form": "mix"}}, "'blend', 'rhp'"),
    ],
)
def test_unknown_names_and_bad_values_are_refused(
    task: str, overrides: dict[str, object], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        reach_config(task, overrides)
