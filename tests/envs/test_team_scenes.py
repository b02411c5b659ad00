"""Scenes of the team's tasks: their limits, their walls, and what is refused."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest

from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import TASKS, fewest_steps, make_task
from marl_mm.envs.task import Values
from marl_mm.envs.tasks.quiet_zone import QuietZone
from marl_mm.envs.window import Window
from marl_mm.errors import UsageError
from tests.envs.teams import KINDS, episodes

# --- Limits ------------------------------------------------------------------


def failed_and_not(task: Any) -> tuple[np.ndarray, np.ndarray]:
    """Rewards of a failed step and of one that is not, far from the goal."""
    width = len(task.layout.compared)
    terms = {name: np.zeros(2) for name in task.needs}
    terms["failed"] = np.array([1.0, 0.0])
    achieved = np.full((2, width), -5.0)
    rewards: tuple[np.ndarray, np.ndarray] = task.reward(achieved, 0 * achieved, terms)
    return rewards


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "MovingReach"])
def test_a_failed_step_brings_the_reward_of_a_failure(kind: str) -> None:
    for reward in (TASKS.get(f"{kind}-v0").failure_reward, -7.5):  # type: ignore[attr-defined]
        task = make_task(f"{kind}-v0", {"failure_reward": reward})
        failed, other = failed_and_not(task)
        assert failed == reward != other


LIMITS = {
    ("QuietZone-v0", "zone_limit"): "zone_acceleration",
    ("Gate-v0", "quiet_limit"): "floor_acceleration",
    ("Bar-v0", "largest_tilt"): "bar_tilt",
    ("Bar-v0", "largest_stretch"): "bar_stretch",
    ("Course-v0", "zone_limit"): "zone_acceleration",
}
"""What a step's number is held against, by task and field."""


@pytest.mark.slow
@pytest.mark.parametrize(("task", "field"), LIMITS)
def test_an_episode_fails_just_beyond_its_limit(task: str, field: str) -> None:
    """An expert's highest number, with limits 2 % above it and 2 % below."""

    def lags(action: dict[str, float], seen: Values) -> None:
        if "right_delta_x" in action:
            action["right_delta_x"] *= 0.95
            action["right_delta_y"] = 0.02

    (free,) = episodes(task, 1, lags, **{field: 180.0})
    measured = free.info[LIMITS[task, field]]
    highest = measured.max()
    limit = float(np.rad2deg(highest) if field == "largest_tilt" else highest)
    (above,) = episodes(task, 1, lags, **{field: 1.02 * limit})
    (below,) = episodes(task, 1, lags, **{field: 0.98 * limit})
    np.testing.assert_array_equal(above.states, free.states)
    assert below.reason and below.reason != free.reason == above.reason
    assert len(below) == 1 + (measured > 0.98 * highest).argmax()


def test_a_cup_spills_at_its_rim_which_is_that_of_the_steps_start() -> None:
    def steady(action: dict[str, float], seen: Values) -> None:
        action |= {"delta_x": -0.5, "delta_y": 0.2, "delta_z": 0.0, "alpha": 0.5}

    (free,) = episodes("Tray-v0", 1, steady, rim_full=0.5, rim_dry=1.0)
    level = free.states[:-1, free.layout.state_names.index("level")]
    np.testing.assert_allclose(free.info["rim"], 1.0 - 0.5 * level)
    peak = float(free.info["slosh_peak"].max())
    for rim, spills in ((1.02 * peak, False), (0.98 * peak, True)):
        (episode,) = episodes("Tray-v0", 1, steady, rim_full=rim, rim_dry=rim)
        assert (episode.reason == "the cup spilled") == spills


# --- The wall ----------------------------------------------------------------


@pytest.mark.parametrize("rise", [-0.08, 0.0, 0.08])
def test_the_window_has_a_roof_and_a_sill(rise: float) -> None:
    """Who follows its slant passes at its height, and no higher or lower."""

    def along(action: dict[str, float], seen: Values) -> None:
        action["delta_z"] = 10 * (seen["gate_z"] + rise - seen["end_effector_z"])
        if (ahead := 0.1 - seen["gate_distance"]) > 0:
            y = seen["gate_y"] + seen["gate_slope"] * ahead
            action["delta_y"] = 10 * (y - seen["end_effector_y"])
            action["delta_x"] = 1.0

    (episode,) = episodes("Gate-v0", 1, along)
    beyond = episode.states[-1, episode.layout.state_names.index("gate_distance")]
    if rise:
        assert episode.reason == "the hand touched the wall"
        assert episode.info["window_error"][-1] == pytest.approx(0.08, abs=0.01)
    else:
        assert episode.reason == "" and beyond < -0.2


def test_the_error_in_a_window_is_the_larger_one_within_the_wall() -> None:
    window = Window(x=1.0, y=0.1, z=0.6, slope=0.5)
    middle = np.array([1.1, 0.15, 0.6])
    for aside, error in [
        ((0.0, 0.0, 0.04), 0.04),
        ((0.0, 0.0, -0.03), 0.03),
        ((0.0, 0.02, 0.01), 0.02),
        ((0.0, -0.05, 0.01), 0.05),
        ((-0.11, 0.5, 0.5), 0.0),  # before the wall
        ((0.11, 0.5, 0.5), 0.0),  # beyond
    ]:
        hand_w = np.stack([middle, middle + aside])
        assert window.error(hand_w, thickness=0.2) == pytest.approx(error)


def test_the_wall_is_drawn_around_the_window_and_above_the_base() -> None:
    window = Window(x=1.0, y=0.1, z=0.6, slope=0.5)
    walls = window.walls(thickness=0.2, clearance=0.025)
    place, size = (
        np.array([getattr(m, n) for m in walls]) for n in ("position_w", "size")
    )
    low, high = place - size / 2, place + size / 2
    assert low[:, 2].min() > 0.352  # the base's top
    assert (low[:, 0].min(), high[:, 0].max()) == pytest.approx((1.0, 1.2))

    def drawn(aside: float, up: float) -> bool:
        point = np.array([1.1125, 0.15625 + aside, 0.6 + up])  # a slice's middle
        return bool(((low < point) & (point < high)).all(axis=1).any())

    for aside, up in [(0, 0), (0.024, 0.024), (-0.024, -0.024)]:
        assert not drawn(aside, up)
    for aside, up in [(0, 0.05), (0, -0.05), (0.05, 0), (-0.05, 0), (0.2, 0.04)]:
        assert drawn(aside, up)


@pytest.mark.parametrize(
    "engine", ["mujoco", pytest.param("bullet", marks=pytest.mark.bullet)]
)
def test_what_is_drawn_changes_nothing(engine: str) -> None:
    task = make_task("Gate-v0", {"simulation": {"engine": engine}})
    states = []
    for visual in (False, True):
        with closing(EpisodeCore(task, visual=visual)) as core:
            states.append([core.reset(np.random.default_rng(0))])
            for _ in range(3):
                states[-1].append(core.step(np.array([1.0, 0.5, 0.1, 0.3])).state)
    plain, drawn = states
    np.testing.assert_array_equal(plain, drawn)


def test_a_zone_as_long_as_its_room_is_drawn() -> None:
    for ends in ((-0.6, -0.15), (-0.55, -0.15), (-0.65, -0.25)):
        length = ends[1] - ends[0]
        task = QuietZone(zone_x=ends, zone_length=(length, length))
        zones = task.draw(np.random.default_rng(0))
        np.testing.assert_allclose(zones, [ends[::-1]], atol=1e-9)


# --- Bad input ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("task", "fields", "error"),
    [
        ("QuietZone-v0", {"zone_x": (-2.0, -1.8)}, "zone_x is -2 to -1.8, expected"),
        ("QuietZone-v0", {"zone_x": (-0.3, 0.1)}, "zone_x is -0.3 to 0.1, expected"),
        ("QuietZone-v0", {"zone_length": (0.1, 0.6)}, "do not fit into zone_x"),
        ("QuietZone-v0", {"zones": 3}, "zones is 3, expected 1 or 2"),
        (
            "Gate-v0",
            {"wall": {"x": (1.9, 2.0)}},
            "a wall at 1.9 to 2.2 m is not",
        ),
        (
            "Gate-v0",
            {"wall": {"x": (0.6, 0.6)}},
            "a wall at 0.6 to 0.8 m is not",
        ),
        ("Gate-v0", {"wall": {"slope": (0.5, 2.0)}}, "wall.slope is 0.5 to 2"),
        ("Tray-v0", {"goal_x": (-2.0, -2.0)}, "dry in 10 steps: goal_x is -2 to"),
        ("Tray-v0", {"level": (0.5, 1.5)}, "level is 0.5 to 1.5, expected within"),
        ("MovingReach-v0", {"speed": (0.1, 0.5)}, "which a hand follows"),
        ("MovingReach-v0", {"speed": (0.1, 0.05)}, "expected the smaller first"),
        ("Course-v0", {"zone_x": (0.5, 0.7)}, "a zone of 0.4 m does not fit into zone"),
        ("Course-v0", {"bin_x": (4.1, 4.1)}, "a wall at 4 to 4.4 m is not between"),
        ("Bar-v0", {"beam_x": (-0.5, 0.3)}, "expected between goals and start"),
        ("QuietZone-v0", {"zone_limit": -1.0}, "zone_limit is -1.0, expected > 0"),
        ("QuietZone-v0", {"zone_length": (-0.2, -0.1)}, "zone_length is -0.2 to -0.1"),
        ("QuietZone-v0", {"goal_x": (-20.0, -20.0)}, "a way of 20.60 m, expected at"),
        ("QuietZone-v0", {"zone_x": (-1.4, -1.2)}, "expected within -1.2 to -0.15 m"),
        ("QuietZone-v0", {"goal_y": (2.0, 2.0)}, "goal_y is 2 to 2 m, expected within"),
        ("QuietZone-v0", {"goal_z": (1.0, 2.0)}, "goal_z is 1 to 2 m, expected within"),
        ("QuietZone-v0", {"max_steps": 14}, "most 1.4 m, as far as a hand goes in 14"),
        ("Gate-v0", {"wall": {"z": (3.0, 3.0)}}, "wall.z is 3 to 3 m, expected within"),
        ("Gate-v0", {"wall": {"y": (5.0, 5.0)}}, "wall.y is 4.84 to 5.16 m, expected"),
        (
            "Gate-v0",
            {"wall": {"clearance": 0.0}},
            "wall.clearance is 0.0, expected > 0",
        ),
        ("Gate-v0", {"wall": {"clearance": -1.0}}, "wall.clearance is -1.0, expected"),
        ("Gate-v0", {"wall": {"thickness": -0.1}}, "wall.thickness is -0.1, expected"),
        ("Gate-v0", {"quiet_limit": -1.0}, "quiet_limit is -1.0, expected > 0"),
        ("Gate-v0", {"goal_x": (50.0, 60.0)}, "a way of 59.30 m, expected at most 1.7"),
        ("Gate-v0", {"wall": {"y": (0.9, 0.9)}}, "a way of 1.90 m through the window"),
        ("Gate-v0", {"failure_reward": 5.0}, "failure_reward is 5, expected below 0"),
        (
            "Course-v0",
            {"load": {"failure_reward": -3.0}},
            "-3, expected -10, as it has",
        ),
        ("Course-v0", {"load": {"lift": 0.3}}, "lift is 0.3, expected 0, as it has"),
        ("Tray-v0", {"frequency": 63.0}, "is 63 Hz, expected below 62.6 Hz"),
        ("Gate-v0", {"goal_reward": -50.0}, "goal_reward is -50.0, expected > 0"),
        ("Tray-v0", {"goal_y": (1.3, 1.3)}, "dry in 10 steps: goal_y is 1.3 to 1.3 m"),
        ("MovingReach-v0", {"ticks_per_step": 480}, "at most 0.05, which a hand"),
        ("Gate-v0", {"max_steps": 3}, "a way of 1.20 m, expected at most 0.3 m"),
        ("Tray-v0", {"goal_z": (5.0, 5.0)}, "goal_z is 5 to 5 m, expected within 0 to"),
        ("MovingReach-v0", {"circle_z": (5.0, 5.0)}, "circle_z is 4.85 to 5.15 m"),
        (
            "MovingReach-v0",
            {"radius": 5.0},
            "circle_y is -5.1 to 5.1 m, expected within",
        ),
        (
            "MovingReach-v0",
            {"max_steps": 5},
            "at most 0.3 m, as far as a hand goes in 3",
        ),
        (
            "MovingReach-v0",
            {"near_distance": 0.0},
            "near_distance is 0.0, expected > 0",
        ),
        ("Bar-v0", {"goal_x": (-9.0, -9.0)}, "a way of 9.60 m, expected at most 1.3 m"),
        ("Bar-v0", {"goal_z": (-1.0, -1.0)}, "goal_z is -1 to -1 m, expected within 0"),
        ("Bar-v0", {"beam_z": (5.0, 5.0)}, "beam_z is 5 to 5 m, expected within 0 to"),
        ("Bar-v0", {"max_steps": 1}, "a way of 1.05 m, expected at most 0.1 m"),
        ("Course-v0", {"load": {"stand_x": (5.0, 5.0)}}, "load.stand_x is 5 to 5 m"),
        ("Course-v0", {"load": {"stand_y": (2.0, 2.0)}}, "load.stand_y is 2 to 2 m"),
        ("Course-v0", {"bin_y": (4.0, 4.0)}, "bin_y is 4 to 4 m, expected within -1.3"),
        ("Course-v0", {"bin_z": 3.0}, "bin_z is 3 to 3 m, expected within 0 to 1.4"),
        ("Course-v0", {"zone_limit": 0.0}, "zone_limit is 0.0, expected > 0"),
        ("Course-v0", {"max_steps": 5}, "a way of 4.60 m, expected at most 0.5 m"),
        ("Course-v0", {"load": {"hold_ticks": 100000}}, "at most an episode's 20160"),
        *(
            (f"{kind}-v0", {"random_start_steps": 2}, "is 2, expected 0")
            for kind in KINDS
        ),
    ],
)
def test_scenes_that_nobody_can_solve_are_refused_with_numbers(
    task: str, fields: dict[str, Any], error: str
) -> None:
    with pytest.raises(UsageError, match=error):
        make_task(task, fields)


def test_a_quick_episode_has_the_fewest_steps_that_its_task_allows() -> None:
    assert fewest_steps("Reach-v0", 4) == 4
    steps = fewest_steps("Gate-v0", 4)
    assert steps == 13  # 1.9 - 0.647 - 0.05 m, by steps of 0.1 m
    with pytest.raises(UsageError, match="as far as a hand goes in 12 of max_steps"):
        make_task("Gate-v0", {"max_steps": steps - 1})
