"""Tasks in which the team decides: what fails in them, and that experts do not."""

from contextlib import closing
from math import exp, pi, sqrt
from typing import Any

import numpy as np
import pytest

from marl_mm.cli import main
from marl_mm.collectors.scripted import expert_action
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.drive import Tick
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.envs.slosh import swing
from marl_mm.envs.task import ScriptConfig, Values
from marl_mm.envs.tasks.tray import Cup, Tray
from tests.envs.teams import KINDS, MUJOCO, Change, episodes, held, reasons

LEVELS = [f"{kind}{level}-v0" for kind in KINDS for level in ("-easy", "", "-hard")]
SIDED = ("left", "right")


@pytest.mark.parametrize("task", LEVELS)
def test_the_expert_reaches_goals_of_every_level(task: str) -> None:
    number = 1 if task.startswith("Course") else 3
    assert all(episode.success for episode in episodes(task, number))


@pytest.mark.slow
@pytest.mark.bullet
@pytest.mark.parametrize("kind", KINDS)
def test_the_expert_reaches_goals_on_pybullet(kind: str) -> None:
    bullet = {"engine": "bullet"}
    run = episodes(f"{kind}-v0", 1, simulation=bullet)
    assert all(episode.success for episode in run)


def test_scenes_follow_from_the_seed_and_differ() -> None:
    for kind in KINDS:
        core = EpisodeCore(make_task(f"{kind}-v0", MUJOCO))
        with closing(core):
            first, again, other = (
                core.reset(np.random.default_rng(seed)) for seed in (1, 1, 2)
            )
        np.testing.assert_array_equal(first, again)
        assert not np.array_equal(first, other)


def test_a_team_of_the_paper_sees_what_its_layout_says() -> None:
    """No agent but the one that has to tell sees what decides."""
    secrets = {
        "QuietZone-v0": ("zone_1_near", "balance"),
        "Gate-v0": ("gate_y", "end_effector"),
        "Tray-v0": ("level", "balance"),
        "MovingReach-v0": ("goal_rate", "balance"),
    }
    for task, (entry, knows) in secrets.items():
        seers = [a.name for a in TASKS.get(task).layout.team if entry in a.sees]
        assert seers == [knows]


@pytest.mark.parametrize("kind", ["QuietZone", "Gate"])
def test_halves_are_the_first_or_the_second_and_both_are_drawn(kind: str) -> None:
    starts = set()
    for episode in episodes(f"{kind}-halves-v0", 6):
        assert episode.success
        layout = episode.layout
        x = episode.states[:, layout.state_names.index("end_effector_x")]
        goal = episode.states[0, layout.state_names.index("goal_x")]
        begun = abs(x[0] - 0.647) > 0.3
        starts.add(begun)
        whole = TASKS.get(f"{kind}-v0").goal_x  # type: ignore[attr-defined]
        assert (whole[0] <= goal <= whole[1]) == begun
    assert starts == {True, False}


# --- QuietZone ---------------------------------------------------------------


def test_a_zone_is_broken_in_a_hurry_and_passed_too_late_at_rest() -> None:
    task = "QuietZone-v0"
    for alpha in (0.0, 0.5):
        assert reasons(task, held(alpha)) == {"the base was not quiet in a zone"}
    late = list(episodes(task, 3, held(1.0)))
    assert all(episode.truncated[-1] and not episode.failed.any() for episode in late)


def test_zone_acceleration_is_that_of_the_ticks_within() -> None:
    core = EpisodeCore(make_task("QuietZone-v0", MUJOCO | {"zone_limit": 9.0}))
    ticks: list[Tick] = []
    with closing(core):
        state = core.reset(np.random.default_rng(0))
        near, far = state[7:9]
        felt: list[float] = []
        while not felt or core.attempt.steps < 14:  # type: ignore[union-attr]
            ticks.clear()
            step = core.step(np.array([-1.0, 0.0, 0.0, 0.3]), ticks.append)
            within = [
                abs(tick.command.acceleration[0])
                for tick in ticks
                if far < tick.state.q[0] < near
            ]
            felt.append(max(within, default=0.0))
            assert step.info["zone_acceleration"] == felt[-1]
    assert max(felt) > 0.5 and felt[0] == 0.0


# --- Gate --------------------------------------------------------------------


def test_the_hand_touches_the_wall_beside_the_window_or_with_a_stable_base() -> None:
    def aside(action: dict[str, float], seen: Values) -> None:
        if 0 > seen["gate_distance"] > -0.2:
            action["delta_y"] = -action["delta_y"]

    touched = {"the hand touched the wall"}
    assert reasons("Gate-v0", aside) == touched
    assert reasons("Gate-v0", held(1.0)) == touched
    assert reasons("Gate-v0", held(0.0)) == {"the base was not quiet before the wall"}


# --- Tray --------------------------------------------------------------------


def test_the_liquid_moves_as_a_damped_spring_that_is_pushed() -> None:
    """A hand that sets off at once: the exact solution, to the step of 1/240 s."""
    task, ticks, speed = Tray(damping=0.1), 240, 0.3
    rate = 2 * pi * task.frequency
    own = rate * sqrt(1 - task.damping**2)
    time = np.arange(1, ticks) / 240
    exact = -speed / own * np.exp(-task.damping * rate * time) * np.sin(own * time)
    still = np.zeros((3, 3))
    x = np.concatenate([still[:, 0], speed * np.arange(1, ticks + 1) / 240])
    path = np.stack([x, 0 * x, 0 * x], axis=1)
    cup, swings = Cup(0.5, np.zeros((2, 2)), np.empty((0, 3))), []
    for k in range(3, ticks + 2):
        swing(path[k - 2 : k + 1], cup.motion, rate, task.damping)
        swings.append(cup.motion[0, 0])
    np.testing.assert_allclose(swings, exact, atol=0.03 * speed / own)
    assert exp(-task.damping * rate) < 0.5  # it has mostly died away


def test_a_full_cup_spills_in_a_hurry_and_a_low_one_is_dry_by_caution() -> None:
    full: dict[str, Any] = {"level": (0.9, 1.0)}
    low: dict[str, Any] = {"level": (0.45, 0.5)}
    hurry = episodes("Tray-v0", 3, held(0.0), **full)
    assert {episode.reason for episode in hurry} == {"the cup spilled"}
    caution = episodes("Tray-v0", 3, held(0.6), **low)
    assert {episode.reason for episode in caution} == {"the cup is dry"}
    for levels in (full, low):
        assert all(e.success for e in episodes("Tray-v0", 3, **levels))


# --- MovingReach -------------------------------------------------------------


def test_the_goal_stays_on_its_circle_at_its_speed() -> None:
    (episode,) = episodes("MovingReach-v0", 1, held(0.5))
    names = episode.layout.state_names
    goal, centre = (
        episode.states[:, [names.index(f"{of}_{axis}") for axis in "xyz"]]
        for of in ("goal", "circle")
    )
    task = TASKS.get("MovingReach-v0")
    radius = np.linalg.norm(goal - centre, axis=1)
    np.testing.assert_allclose(radius, task.radius)  # type: ignore[attr-defined]
    way = np.linalg.norm(np.diff(goal, axis=0), axis=1)
    rate = abs(episode.states[0, names.index("goal_rate")])
    chord = 2 * np.sin(rate / 2) * task.radius  # type: ignore[attr-defined]
    np.testing.assert_allclose(way, chord)


def test_three_seconds_in_a_row_near_the_goal_end_the_episode() -> None:
    for episode in episodes("MovingReach-v0", 3):
        near = episode.states[1:, episode.layout.state_names.index("seconds_near")]
        assert near[-3:].tolist() == [1.0, 2.0, 3.0]
        assert ((episode.info["gap"] < 0.025) == (near > 0)).all()


# --- Bar ---------------------------------------------------------------------


def agreed(*conventions: str) -> Change:
    """Each robot by the convention of its place."""

    def change(action: dict[str, float], seen: Values) -> None:
        task = TASKS.get("Bar-v0")
        for side, convention in zip(SIDED, conventions, strict=True):
            own = task.expert(seen, ScriptConfig(convention=convention))
            action |= {n: value for n, value in own.items() if n.startswith(side)}

    return change


@pytest.mark.slow
def test_teams_of_one_convention_pass_the_beam_and_mixed_ones_do_not() -> None:
    for convention in ("over", "under"):
        change = agreed(convention, convention)
        for episode in episodes("Bar-v0", 3, change):
            assert episode.success
            names = episode.layout.state_names
            x, z = (episode.states[:, names.index(n)] for n in ("bar_x", "bar_z"))
            beam_x, beam_z = (
                episode.states[0, names.index(n)] for n in ("beam_x", "beam_z")
            )
            above = z[np.abs(x - beam_x).argmin()] > beam_z
            assert above == (convention == "over")
    for mixed in (("over", "under"), ("under", "over")):
        assert reasons("Bar-v0", agreed(*mixed)) == {"the bar tilted"}


def test_a_bar_that_goes_straight_on_touches_the_beam() -> None:
    def straight(action: dict[str, float], seen: Values) -> None:
        for side in SIDED:
            action[f"{side}_delta_z"] = 0.0

    assert reasons("Bar-v0", straight) == {"the bar touched the beam"}


def test_a_robot_that_waits_drops_the_bar() -> None:
    def waits(action: dict[str, float], seen: Values) -> None:
        action["right_delta_x"] = 0.0

    assert reasons("Bar-v0", waits, 1) == {"the bar tilted"}


def test_agents_see_the_other_hand_a_step_late() -> None:
    (episode,) = episodes("Bar-v0", 1)
    names = episode.layout.state_names
    for side in SIDED:
        hand, late = (
            episode.states[:, [names.index(f"{side}_{of}_{axis}") for axis in "xyz"]]
            for of in ("end_effector", "late")
        )
        np.testing.assert_array_equal(late[1:], hand[:-1])


# --- Course ------------------------------------------------------------------


def test_sub_goals_come_in_order_and_give_a_point_each() -> None:
    (episode,) = episodes("Course-v0", 1)
    stage = episode.states[:, episode.layout.state_names.index("stage")]
    assert set(np.diff(stage)) == {0.0, 1.0} and stage[-1] == 5.0
    np.testing.assert_array_equal(episode.rewards, np.diff(stage))
    assert 60 <= len(episode.rewards) <= 120


def test_a_block_let_go_before_the_bin_is_lost_and_over_it_is_not() -> None:
    def early(action: dict[str, float], seen: Values) -> None:
        if seen["stage"] == 1:
            action["grip"] = -1.0

    (episode,) = episodes("Course-v0", 1, early)
    assert episode.reason == "dropped" and episode.rewards[-1] == -1.0


@pytest.mark.slow
def test_the_zone_and_the_wall_of_the_course_are_those_of_the_other_tasks() -> None:
    (hurried,) = episodes("Course-v0", 1, held(0.0))
    assert hurried.reason == "the base was not quiet in the zone"
    (lagging,) = episodes("Course-v0", 1, held(0.75))
    assert lagging.reason == "the hand touched the wall"


# --- Bad input ---------------------------------------------------------------


def test_other_levels_and_conventions_are_told_the_nearest(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["play", "scripted", "--task", "Gate-hrd-v0", "--strip", "x.png"]) == 2
    assert "Gate-hard-v0" in capsys.readouterr().err
    collect = ["collect", "scripted", "--task"]
    assert main([*collect, "Bar-v0", "--convention", "ovr"]) == 2
    assert "convention is 'ovr', expected over or under" in capsys.readouterr().err
    assert main([*collect, "Reach-v0", "--convention", "over"]) == 2
    assert "convention is 'over', and Reach has none" in capsys.readouterr().err


def test_a_second_away_from_the_goal_begins_the_count_anew() -> None:
    task = make_task("MovingReach-v0", {"simulation": {"engine": "mujoco"}})
    names = task.layout.state_names
    near = names.index("seconds_near")
    with closing(EpisodeCore(task)) as core:
        state = core.reset(np.random.default_rng(0))
        while not state[near]:
            seen = dict(zip(names, state.tolist(), strict=True))
            state = core.step(expert_action(task, seen, ScriptConfig())).state
        away = core.step(np.array([1.0, 1.0, 1.0, 0.5])).state
    assert state[near] == 1.0 and away[near] == 0.0


FREE = MUJOCO | {"largest_tilt": 180.0, "largest_stretch": 9.0, "beam_size": 0.02}
"""A bar that nothing happens to."""


def moved(side: str, *step: float) -> np.ndarray:
    """The action of one robot while the other one stands."""
    action = dict.fromkeys(make_task("Bar-v0").layout.action_names, 0.0)
    names = [f"{side}_{name}" for name in ("delta_x", "delta_y", "delta_z", "alpha")]
    return np.array([*(action | dict(zip(names, step, strict=True))).values()])


def farthest(core: EpisodeCore, action: np.ndarray) -> float:
    """Distance of a hand to its target in the third step."""
    core.reset(np.random.default_rng(0))
    return [float(core.step(action).info["d_mm"]) for _ in range(3)][-1]


def test_of_two_hands_the_one_that_is_farther_from_its_target_counts() -> None:
    with closing(EpisodeCore(make_task("Bar-v0", FREE))) as core:
        still = farthest(core, moved("left", 0.0, 0.0, 0.0, 1.0))
        for side in SIDED:
            assert farthest(core, moved(side, -1.0, 0.0, 0.0, 1.0)) > 2 * still


@pytest.mark.parametrize("side", SIDED)
def test_an_arm_of_either_robot_that_collides_ends_the_episode(side: str) -> None:
    with closing(EpisodeCore(make_task("Bar-v0", FREE))) as core:
        core.reset(np.random.default_rng(0))
        steps = (core.step(moved(side, 0.0, 0.0, -1.0, 0.0)) for _ in range(13))
        reasons = [step.info["reason"] for step in steps if step.terminated]
    assert reasons[:1] == ["collision of the block and the ground"]


def test_each_robot_carries_half_of_the_bar() -> None:
    with closing(EpisodeCore(make_task("Bar-v0", {"bar_mass": 3.0}))) as core:
        core.reset(np.random.default_rng(0))
        masses = [drive.hand.payload.true_mass for drive in core.drives if drive.hand]
    assert masses == [1.5, 1.5]


@pytest.mark.parametrize(
    "name",
    [
        *("Reach-v0", "QuietZone-v0", "Gate-v0", "Bar-v0", "Grasp-v0", "Course-v0"),
        *("Tray-v0", "MovingReach-v0"),  # whose alpha has a meaning of its own
    ],
)
def test_the_script_does_what_its_settings_say(name: str) -> None:
    """Near a goal its steps are in proportion to kp; alpha is the one asked for."""
    task = make_task(name)
    state = dict.fromkeys(task.layout.state_names, 0.0)
    state |= {entry: 0.1 for entry in state if entry.endswith(("goal_x", "object_x"))}
    once, twice = (
        task.expert(state, ScriptConfig(kp=kp, alpha=0.3)) for kp in (0.1, 0.2)
    )
    steps = [entry for entry in once if "delta" in entry]
    assert any(once[entry] for entry in steps)
    for entry in steps:
        assert twice[entry] == pytest.approx(2 * once[entry])
    if name not in ("Tray-v0", "MovingReach-v0"):
        assert {once[e] for e in once if e.endswith("alpha")} == {0.3}
