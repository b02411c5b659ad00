"""A load in the hand: held by friction, weighed by the joints, dropped for a reason."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from itertools import product
from typing import Any
from xml.etree import ElementTree

import gymnasium
import numpy as np
import pytest

import marl_mm  # noqa: F401  registers the environments
from marl_mm.algorithms.pretrained import load_pretrained
from marl_mm.collectors.scripted import ScriptedPolicy
from marl_mm.control.config import HEAVIEST
from marl_mm.control.payload import Payload
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.drive import Tick
from marl_mm.envs.load import LoadConfig
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.envs.rollout import EpisodePlan, run_episode
from marl_mm.envs.task import Attempt, ScriptConfig
from marl_mm.envs.tasks.carry import Carry
from marl_mm.envs.tasks.grasp import LAYOUT as HANDLING
from marl_mm.envs.tasks.reach import Reach
from marl_mm.errors import UsageError
from marl_mm.robot.description import RobotConfig, urdf_xml
from marl_mm.robot.limits import RobotLimits, robot_limits
from marl_mm.robot.model import ACTUATED, RobotModel, RobotState
from marl_mm.robot.names import FINGER_JOINTS
from marl_mm.robot.planar import PlanarModel
from marl_mm.sim.config import SimulationConfig
from marl_mm.sim.scene import Block

OpenWorld = Callable[..., EpisodeCore]

STAY = np.zeros(4)

AHEAD, BEHIND = (1.4, 0.0, 0.7), (-1.0, 0.0, 0.7)


class CarrySometimes(Carry):
    """Seeds above 0 have nothing to carry."""

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        bit_generator: Any = rng.bit_generator
        loaded = bit_generator.seed_seq.entropy == 0
        (Carry if loaded else Reach).begin(self, attempt, rng, goal)


def test_no_load_is_left_in_the_hand_of_an_episode_without_one() -> None:
    used, fresh = (
        EpisodeCore(CarrySometimes(load=LoadConfig(knowledge="given"))) for _ in "12"
    )
    used.reset(np.random.default_rng(0))
    used.step(STAY)
    states = [core.reset(np.random.default_rng(1)) for core in (used, fresh)]
    steps = [core.step(np.array([1.0, 0.0, 0.0, 0.5])) for core in (used, fresh)]
    used.close()
    fresh.close()
    assert states[0].tobytes() == states[1].tobytes()
    assert steps[0].state.tobytes() == steps[1].state.tobytes()


def test_a_load_is_a_setting_of_the_tasks_that_have_one() -> None:
    task = make_task("CarryReach-v0", {"load": {"mass": [1, 2]}})
    assert isinstance(task, Carry) and task.load.mass == (1.0, 2.0)
    with pytest.raises(UsageError, match=r"unknown field 'load\.weight'"):
        make_task("CarryReach-v0", {"load": {"weight": 1.0}})
    with pytest.raises(UsageError, match="unknown field 'load'"):
        make_task("Reach-v0", {"load": {"mass": [1, 2]}})


def exactly(value: float) -> tuple[float, float]:
    return value, value


def begun(core: EpisodeCore, seed: int = 0) -> np.ndarray:
    return core.reset(np.random.default_rng(seed), np.array([1.3, 0.0, 0.7]))


@pytest.mark.parametrize("mass", [0.1, 1.0, 3.0])
def test_the_joints_torques_tell_the_mass(mass: float, open_world: OpenWorld) -> None:
    core = open_world("CarryReach-v0", mass=exactly(mass))
    begun(core)
    core.step(STAY)
    assert core.drive.hand is not None
    assert core.drive.hand.payload.mass == pytest.approx(mass, rel=0.02)


def test_a_load_that_nobody_knows_pulls_the_hand_down(open_world: OpenWorld) -> None:
    errors = {}
    for knowledge in ("none", "estimated", "given"):
        core = open_world("CarryReach-v0", mass=exactly(2.0), knowledge=knowledge)
        begun(core)
        errors[knowledge] = core.step(STAY).info["d_mm"]
    assert errors["none"] > 0.03
    assert errors["estimated"] < 0.003 and errors["given"] < 0.003


@pytest.mark.parametrize("grasp", ["friction", "weld"])
def test_the_block_goes_where_the_hand_goes(grasp: str, open_world: OpenWorld) -> None:
    core = open_world("CarryReach-v0", mass=exactly(1.5), grasp=grasp)
    state = begun(core)
    policy = load_pretrained()
    while True:
        step = core.step(policy.act(state))
        state = step.state
        block_w, _ = core.drive.world.handling.block_w()
        assert np.linalg.norm(block_w - state[:3]) < 0.005
        if step.terminated or step.truncated:
            break
    assert step.info["is_success"] and step.info["reason"] == ""


def test_with_a_welded_block_the_wheels_carry_the_robot(open_world: OpenWorld) -> None:
    """As without: what changes contacts in the engine could take their load off."""
    core = open_world("CarryReach-v0", mass=exactly(0.05), grasp="weld")
    begun(core)
    for _ in range(2):
        step = core.step(np.array([1.0, 0.0, 0.0, 0.0]))
        assert step.info["wheel_slip"] < 0.001
    assert core.drive.state.q[0] > 0.05 and abs(core.drive.state.yaw) < 0.003


def test_a_slippery_block_is_dropped(open_world: OpenWorld) -> None:
    core = open_world("CarryReach-v0", mass=exactly(2.5), friction=exactly(0.1))
    begun(core)
    step = core.step(STAY)
    assert step.terminated and not step.truncated
    assert step.info["reason"] == "dropped" and not step.info["is_success"]
    assert step.reward < -9.9
    assert core.drive.hand is not None and core.drive.hand.payload.mass == 0.0


@pytest.mark.parametrize(
    ("overrides", "action", "reason"),
    [
        ({}, (-1.0, 0.0, -1.0, 1.0), "base_link and panda_finger1"),
        ({"grasp": "weld"}, (-1.0, 0.0, -0.3, 1.0), "the block and base_link"),
        ({}, (0.0, 0.0, -1.0, 0.0), "the block and the ground"),
    ],
)
def test_who_collides_is_told(
    overrides: dict[str, Any],
    action: tuple[float, ...],
    reason: str,
    open_world: OpenWorld,
) -> None:
    core = open_world("CarryReach-v0", mass=exactly(0.5), **overrides)
    begun(core)
    for _ in range(25):
        step = core.step(np.array(action))
        if step.terminated:
            break
    assert step.terminated and step.info["reason"] == f"collision of {reason}"


@pytest.mark.parametrize(
    ("task", "share", "knowledge"),
    [
        (*cell, knowledge)
        for cell in (
            ("CarryReach-v0", 0.85),
            ("Grasp-v0", 0.7),
            ("GraspReach-v0", 0.85),
        )
        for knowledge in ("given", "estimated")
    ],
)
def test_torques_stay_within_their_limits_with_the_heaviest_load(
    task: str,
    share: float,
    knowledge: str,
    monkeypatch: pytest.MonkeyPatch,
    open_world: OpenWorld,
) -> None:
    """With a share of its torques the arm needs all of them: before any is clipped."""

    def weak(config: RobotConfig) -> RobotLimits:
        whole = robot_limits(config)
        return whole._replace(torque=share * whole.torque)

    monkeypatch.setattr("marl_mm.envs.drive.robot_limits", weak)
    core = open_world(task, mass=exactly(3.0), knowledge=knowledge)
    drive, most = core.drive, np.zeros(7)

    def watch(tick: Tick) -> None:
        terms = drive.model.evaluate(tick.state)
        inertia = terms.mass_matrix[3:, ACTUATED]
        torque = inertia @ tick.command.acceleration + terms.nonlinear[3:]
        assert not tick.command.safe
        np.maximum(most, abs(torque), out=most)

    script = ScriptedPolicy(ScriptConfig(), make_task(task))
    assert run_episode(core, script, EpisodePlan(0, 3), watch).success
    of_a_tick = 1e-6 if knowledge == "given" else 1e-3  # by which the estimate is newer
    assert 0.99 < (most / drive.limits.torque).max() <= 1 + of_a_tick


def test_the_gripper_presses_and_moves_as_its_data_sheet_says() -> None:
    config = SimulationConfig()
    root = ElementTree.fromstring(urdf_xml(RobotConfig()))
    for name in FINGER_JOINTS:
        limit = root.find(f"joint[@name='{name}']/limit")
        assert limit is not None
        assert float(limit.attrib["effort"]) == config.grip_force
        assert float(limit.attrib["velocity"]) == config.grip_speed


@pytest.mark.slow
def test_the_margin_is_of_the_load_as_it_is(open_world: OpenWorld) -> None:
    """While the joints still weigh what was taken, and if nobody ever knows it."""
    margins: dict[tuple[str, float], float] = {}
    for knowledge, mass in product(("none", "estimated", "given"), (0.05, 3.0)):
        core = open_world("Grasp-v0", mass=exactly(mass), knowledge=knowledge)
        episode = run_episode(
            core, ScriptedPolicy(ScriptConfig(), core.task), EpisodePlan(0, 3)
        )
        margins[knowledge, mass] = episode.info["zmp_margin"].min()
    for knowledge in ("none", "estimated", "given"):
        taken = margins[knowledge, 0.05] - margins[knowledge, 3.0]
        assert 0.01 < taken < 0.03  # 3 kg on 0.4 m to the side, of 105 kg
    assert margins["estimated", 3.0] == pytest.approx(margins["given", 3.0], abs=0.005)


def test_an_episode_tells_failure_from_success(open_world: OpenWorld) -> None:
    core = open_world("CarryReach-v0", mass=exactly(2.5), friction=exactly(0.1))
    episode = run_episode(core, load_pretrained(), EpisodePlan(0, 7))
    assert episode.terminated[-1] and episode.failed[-1] and not episode.success


@pytest.mark.parametrize("iterations", [30, 100])
def test_pads_press_with_the_grip_s_force(iterations: int) -> None:
    """However well PyBullet's contact solver converges."""
    overrides = {"simulation": {"engine": "bullet", "grasp_iterations": iterations}}
    core = EpisodeCore(make_task("CarryReach-v0", overrides))
    begun(core)
    core.step(STAY)
    handling: Any = core.drive.world.handling
    forces: dict[int, float] = {}
    for contact in handling._contacts(handling._block):
        finger, force = contact[4], contact[9]
        forces[finger] = forces.get(finger, 0.0) + force
    expected = core.task.simulation.grip_force
    np.testing.assert_allclose([*forces.values()], [expected] * 2, rtol=0.05)
    core.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "goal"),
    [
        (name, goal)
        for name, task in TASKS.items()
        if isinstance(task, Carry)
        for goal in ((None,) if getattr(task.load, "lift", 0) else (AHEAD, BEHIND))
    ],
)
def test_it_does_not_pay_to_fail(
    task: str, goal: tuple[float, float, float] | None, open_world: OpenWorld
) -> None:
    """To fail at once costs more than to stand still until the end, which costs more
    than to do what is asked."""
    config, core = make_task(task), open_world(task)
    script = ScriptedPolicy(ScriptConfig(), config)
    taken = run_episode(core, script, EpisodePlan(0, 3, goal))
    assert taken.success
    core.reset(np.random.default_rng(3), None if goal is None else np.array(goal))
    still = np.zeros(len(config.layout.action))
    if config.layout == HANDLING:
        still[3] = -1.0
    steps = [core.step(still) for _ in range(config.max_steps)]
    assert isinstance(config, Carry) and not steps[-1].terminated
    stays = sum(step.reward for step in steps)
    assert config.load.failure_reward < stays < taken.episode_return


def test_goals_in_hindsight_do_not_mend_a_drop() -> None:
    config = make_task("CarryReach-v0")
    hit = np.ones((2, 3))
    costs = dict.fromkeys(("d_mm", "d_mp", "base_jerk_rms"), np.zeros(2))
    failed = {**costs, "failed": np.array([False, True])}
    rewards, terminated = config.judge(hit, hit, failed)
    assert isinstance(config, Carry)
    assert rewards.tolist() == [10.0, config.load.failure_reward]
    assert terminated.all()


def test_the_environment_judges_as_the_step_did() -> None:
    overrides = {"load": {"friction": exactly(0.1), "mass": exactly(2.5)}}
    env: Any = gymnasium.make("marl_mm/CarryReach-v0", overrides=overrides)
    observation, _ = env.reset(seed=0)
    observation, reward, terminated, _, info = env.step(STAY.astype(np.float32))
    goals = observation["achieved_goal"], observation["desired_goal"]
    assert env.unwrapped.compute_reward(*goals, info) == reward
    assert env.unwrapped.compute_terminated(*goals, info) == terminated
    env.close()


def test_an_empty_hand_has_nothing_to_feel(open_world: OpenWorld) -> None:
    core = open_world("Reach-v0")
    begun(core)
    assert core.drive.hand is None
    assert "reason" not in core.step(STAY).info


@pytest.mark.parametrize("task", ["CarryReach-v0", "Grasp-v0"])
@pytest.mark.parametrize(
    ("load", "complaint"),
    [
        ({"mass": (0.0, 1.0)}, "load.mass is 0.0 to 1.0, expected 0 < low <= high"),
        ({"edge": (0.06, 0.04)}, "load.edge is 0.06 to 0.04"),
        ({"grasp": "magic"}, "load.grasp is 'magic', expected friction, weld"),
        ({"knowledge": "all"}, "load.knowledge is 'all', expected estimated, given"),
    ],
)
def test_loads_that_make_no_sense_are_refused(
    task: str, load: dict[str, Any], complaint: str, open_world: OpenWorld
) -> None:
    with pytest.raises(UsageError, match=complaint):
        open_world(task, **load)


@pytest.mark.parametrize(
    ("load", "complaint"),
    [
        ({"stand_x": (0.8, 0.6)}, "load.stand_x is 0.8 to 0.6, expected low <= high"),
        ({"stand_edge": 0.0}, "load.stand_edge is 0.0, expected >= load.edge, 0.06"),
        (
            {"stand_x": (0.2, 0.4), "stand_y": (0.0, 0.2)},
            r"load.stand_x is \(0.2, 0.4\) .* expected beside the base",
        ),
        (
            {"stand_x": (0.1, 0.8), "stand_y": (0.0, 0.52)},  # beside it, or not
            "expected beside the base",
        ),
        (
            {"hold_ticks": 10**5},
            "load.hold_ticks is 100000, expected at most an episode's 4800",
        ),
    ],
)
def test_stands_that_make_no_sense_are_refused(
    load: dict[str, Any], complaint: str, open_world: OpenWorld
) -> None:
    with pytest.raises(UsageError, match=complaint):
        open_world("Grasp-v0", **load)


@dataclass(frozen=True, kw_only=True)
class Plank(LoadConfig):
    """A load that is long across the hand."""

    def draw(self, rng: np.random.Generator) -> Block:
        return Block((0.04, 0.30, 0.06), 3.0)


def test_the_model_knows_how_a_long_load_lies() -> None:
    """Its inertia in world axes is the block's, whatever the grasp frame's are."""
    task = Carry(load=Plank(knowledge="given", grasp="weld"))
    with closing(EpisodeCore(task)) as core:
        core.reset(np.random.default_rng(0))
        (drive,) = core.drives
        assert drive.hand is not None
        turned = drive.model.evaluate(drive.state).rotation_w
        moments = [
            np.diag(np.dot(size, size) - np.square(size))
            for size in (drive.hand.payload.size, (0.04, 0.30, 0.06))
        ]
    model, block = turned @ moments[0] @ turned.T, moments[1]
    np.testing.assert_allclose(model, block, atol=0.03 * block.max())


@pytest.mark.parametrize("kind", [RobotModel, PlanarModel])
def test_an_estimate_stays_within_what_a_hand_can_hold(
    kind: type[RobotModel],
) -> None:
    """However hard a joint pushes, up or down."""
    robot = RobotConfig()
    model = kind(robot)
    payload = Payload(model, "estimated", 240.0)
    payload.hold(1.0, (0.05, 0.05, 0.05))
    rest = RobotState(np.array([0, 0, 1, 0, *robot.initial_joints]), np.zeros(10))
    for push, mass in ((1e5, HEAVIEST), (-1e5, 0.0)):
        terms = model.evaluate(rest)
        torque = terms.nonlinear[3:] + push * terms.jacobian[2, 3:]
        payload.learn(rest, terms, torque, rest)
        assert payload.mass == mass
