"""Reward and success, worked by hand and vectorised."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from marl_mm.control.config import ControllerConfig, HierarchyConfig
from marl_mm.envs.registry import TASKS, config_dict, make_task
from marl_mm.envs.task import Task
from marl_mm.envs.tasks.gate import Gate
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.envs.tasks.reach import Reach
from marl_mm.envs.terms import goal_distance
from marl_mm.errors import LayoutError, UsageError
from marl_mm.layout import Entry
from marl_mm.robot.description import RobotConfig
from marl_mm.sim.config import Camera, SimulationConfig
from marl_mm.sim.scene import Block, Mark, Scene

UNSURE = HierarchyConfig(weighted="no")  # type: ignore[arg-type]
ON_GROUND = {"block": Block(), "position_w": (0, 0, 0)}


def terms(shape: tuple[int, ...] = (), **values: float) -> dict[str, np.ndarray]:
    """What rewards depend on, 0 where nothing is said."""
    names = ("d_mm", "d_mp", "base_jerk_rms", "failed")
    return {name: np.full(shape, values.get(name, 0.0)) for name in names}


def at(*distances: float) -> tuple[np.ndarray, np.ndarray]:
    """What was achieved so far away from goals, shapes (n, 3)."""
    achieved = np.zeros((len(distances), 3))
    achieved[:, 1] = distances
    return achieved, np.zeros_like(achieved)


def test_reward_by_hand() -> None:
    """r = -0.3 - 5 * 0.02 - 5 * 0.01."""
    numbers = terms((1,), d_mm=0.02, d_mp=0.01, base_jerk_rms=7.0)
    assert Reach().reward(*at(0.3), numbers) == pytest.approx(-0.45)
    smooth = make_task("SmoothReach-v0")
    assert smooth.reward(*at(0.3), numbers) == pytest.approx(-0.45 - 0.2 * 7)


def test_reaching_pays_ten_instead_of_the_distance() -> None:
    assert Reach().reward(*at(0.049), terms((1,))) == pytest.approx(10.0)
    assert Reach().highest_return == 10.0


def test_success_is_strict_and_depends_on_the_task() -> None:
    places = at(0.019, 0.02, 0.049, 0.05)
    reached = Reach().reached(*places, terms((4,)))
    assert reached.tolist() == [True, True, True, False]
    precise = make_task("PreciseReach-v0").reached(*places, terms((4,)))
    assert precise.tolist() == [True, False, False, False]


def test_terms_are_vectorised() -> None:
    achieved = np.zeros((4, 5, 3))
    desired = np.full((4, 5, 3), 2.0)
    assert goal_distance(achieved, desired).shape == (4, 5)
    numbers = terms((4, 5), d_mm=1.0, d_mp=1.0, base_jerk_rms=1.0)
    reward = Reach().reward(achieved, desired, numbers)
    np.testing.assert_allclose(reward, -np.sqrt(12) - 10)


def test_distances_do_not_depend_on_how_many_there_are() -> None:
    """To the last bit: BLAS, which numpy asks for a single one, is another on each
    processor."""
    rng = np.random.default_rng(0)
    achieved, desired = rng.normal(size=(2, 1000, 3))
    one_by_one = [goal_distance(a, b) for a, b in zip(achieved, desired, strict=True)]
    np.testing.assert_array_equal(one_by_one, goal_distance(achieved, desired))


def test_overrides_reach_nested_fields() -> None:
    config = make_task(
        "Reach-v0", {"max_steps": 50, "controller": {"gains": {"ee_rate": 4.0}}}
    )
    assert config.max_steps == 50
    assert config.controller.gains.ee_rate == 4.0
    assert config.controller.gains.ee_speed == 0.5


def test_overrides_take_json_lists() -> None:
    config = make_task("Reach-v0", {"goal_y": [-0.1, 0.1]})
    assert isinstance(config, Reach) and config.goal_y == (-0.1, 0.1)


@pytest.mark.parametrize(
    ("task", "overrides", "message"),
    [
        ("Fly-v0", {}, "Reach-v0, SmoothReach-v0, PreciseReach-v0"),
        ("Reach-v0", {"maxsteps": 3}, "max_steps"),
        ("Reach-v0", {"controller": {"gain": 3}}, "controller.gain"),
        ("Reach-v0", {"max_steps": 0}, "expected an integer >= 1"),
        ("Reach-v0", {"max_steps": "50"}, "max_steps is '50', expected int"),
        ("Reach-v0", {"cruise": float("nan")}, "cruise is nan, expected a finite"),
        ("Reach-v0", {"goal_y": [0.2]}, "expected 2 numbers"),
        ("Reach-v0", {"action_scale": -1}, "expected > 0"),
        ("Reach-v0", {"controller": 5}, "expected a mapping of its fields"),
        ("Reach-v0", [1], "overrides are .*, expected a mapping"),
        ("Reach-v0", {3: 4}, "a field is 3, expected a name"),
        ("Reach-v0", {"cruise": 10**400}, "expected a finite number"),
        ("Reach-v0", {"random_start_steps": -1}, "expected >= 0"),
        ("GraspReach-v0", {"random_start_steps": 4}, "is 4, expected 0: a hand"),
        ("Reach-v0", {"goal_z": (0.8, 0.6)}, "goal_z is 0.8 to 0.6, expected the"),
        ("Reach-v0", {"robot": {"base_mass": -5}}, "robot.base_mass is -5.0"),
        ("Reach-v0", {"simulation": {"wheel_force": 0}}, "wheel_force is 0.0"),
        (
            "Reach-v0",
            {"controller": {"hierarchy": {"iterations": 0}}},
            "hierarchy.iterations is 0, expected > 0",
        ),
        ("Reach-v0", {"controller": {"form": "mix"}}, "'blend', 'rhp'"),
        ("Reach-v0", {"goal_reward": -10}, "goal_reward is -10.0, expected > 0"),
        ("Reach-v0", {"jerk_weight": -1}, "jerk_weight is -1.0, expected >= 0"),
        ("Reach-v0", {"goal_z": (-5, -4)}, "goal_z.*what a hand reaches"),
        ("Reach-v0", {"standing": -1}, "standing is -1.0, expected >= 0"),
        ("Reach-v0", {"simulation": {"spinning_friction": -1}}, "expected >= 0"),
        (
            "Reach-v0",
            {"controller": {"gains": {"ee_rate": -5}}},
            "controller.gains.ee_rate is -5.0, expected >= 0",
        ),
        (
            "Reach-v0",
            {"controller": {"limits": {"speed_share": 3}}},
            "speed_share is 3.0, expected <= 1",
        ),
        (
            "CarryReach-v0",
            {"load": {"mass": (1.0, 12.0)}},
            "load.mass is up to 12.0, expected <= 10 where it is estimated",
        ),
    ],
)
def test_unknown_names_and_bad_values_are_refused(
    task: str, overrides: Any, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        make_task(task, overrides)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"max_steps": float("nan")}, "max_steps is nan, expected int"),
        ({"max_steps": True}, "max_steps is True, expected int"),
        ({"max_steps": 0}, "max_steps is 0, expected an integer >= 1"),
        ({"ticks_per_step": 240.5}, "ticks_per_step is 240.5, expected int"),
        ({"random_start_steps": 1.5}, "random_start_steps is 1.5, expected int"),
        ({"goal_x_forward": (1.0, float("inf"))}, "goal_x_forward is inf, expected a"),
        ({"goal_x_forward": 1.0}, r"goal_x_forward is 1\.0, expected 2 numbers"),
        ({"goal_x_forward": (1.0, 2.0, 3.0)}, "expected 2 numbers"),
        ({"success_distance": "0.1"}, "success_distance is '0.1', expected a finite"),
        ({"robot": {"base_mass": 100}}, "robot is .*, expected a RobotConfig"),
        ({"stand_off": float("nan")}, "stand_off is nan, expected a finite number"),
        ({"heading_gain": float("inf")}, "heading_gain is inf, expected a finite"),
    ],
)
def test_a_task_of_odd_numbers_is_refused(fields: Any, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Reach(**fields)


def test_numbers_of_a_task_are_pythons_whoever_wrote_them() -> None:
    """Nested ones, too; records are JSON, which has none of NumPy's."""
    nine, force, high = np.int64(9), np.float64(50.0), np.float64(1.5)
    simulation = SimulationConfig(wheel_force=force)
    task = Reach(
        max_steps=nine,  # type: ignore[arg-type]
        goal_reward=20,
        goal_x_forward=[1, high],  # type: ignore[arg-type]
        simulation=simulation,
    )
    same = Reach(
        max_steps=9,
        goal_reward=20.0,
        goal_x_forward=(1.0, 1.5),
        simulation=SimulationConfig(wheel_force=50.0),
    )
    assert task == same
    assert json.dumps(config_dict(task)) == json.dumps(config_dict(same))
    assert type(Entry("goal_z", "m", force, force).low) is float


def test_a_start_elsewhere_is_where_ways_begin() -> None:
    """A hand that starts 0.2 m further ahead is that much nearer to what is ahead."""
    ahead = TASKS.get("Gate-v0").stand_off + 0.2  # type: ignore[attr-defined]
    with pytest.raises(UsageError, match=r"a way of 1.20 m, expected at most 1.1 m"):
        make_task("Gate-v0", {"max_steps": 11})
    assert make_task("Gate-v0", {"max_steps": 11, "stand_off": ahead})
    with pytest.raises(UsageError, match=r"is not between the start at 1.4 m"):
        make_task("Gate-v0", {"stand_off": 1.4})


def test_a_hand_without_an_alpha_needs_an_act_of_its_own() -> None:
    hand, _ = REACH.team
    alone = replace(REACH, action=REACH.action[:3], team=(hand,))
    with pytest.raises(LayoutError, match="action of Alone has no alpha: its class"):
        type("Alone", (Reach,), {"layout": alone})()


@pytest.mark.parametrize(
    ("kind", "fields", "message"),
    [
        (SimulationConfig, {"engine": ["mujoco"]}, "simulation.engine is"),
        (SimulationConfig, {"wheel_force": (1, 2)}, "simulation.wheel_force is"),
        (ControllerConfig, {"gains": {"ee_rate": 5.0}}, "expected a Gains"),
        (ControllerConfig, {"hierarchy": UNSURE}, "weighted is 'no', expected bool"),
        (RobotConfig, {"base_com_b": None}, "robot.base_com_b is None, expected 3"),
        (Camera, {"width": 64.0}, "camera width is 64.0, expected int"),
        (Camera, {"target_w": (1, 2)}, "camera target_w is"),
        (Camera, {"distance": 150}, "camera distance is 150.0 m, expected above 0"),
        (Block, {"mass": 0}, "block mass is 0.0, expected > 0"),
        (Scene, {"block": Block(), "position_w": ("x", 0, 0)}, "a block's position_w"),
        (Scene, {**ON_GROUND, "grasp": "glue"}, "grasp is 'glue'"),
        (Mark, {"position_w": (0, 0, np.nan)}, "a mark's position_w is nan"),
        (Mark, {"position_w": (0, 0, 0), "color": "red"}, "a mark's color is 'red'"),
    ],
)
def test_settings_of_another_kind_are_refused(
    kind: Callable[..., object], fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        kind(**fields)


@pytest.mark.parametrize("size", [(), (0.1, 0.1), 0.05])
def test_marks_have_a_place_and_a_size(size: Any) -> None:
    with pytest.raises(UsageError, match="a mark's size is"):
        Mark((0.0, 0.0, 0.0), size)


def test_halves_need_an_expert() -> None:
    blind = type("Blind", (Gate,), {"expert": Task.expert})
    with pytest.raises(UsageError, match="Blind has no expert to go them"):
        blind(halves=True)
