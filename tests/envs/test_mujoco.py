"""MuJoCo as the engine: the same robot, its contacts, and the compiled step."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from marl_mm.envs import make_task
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.drive import Tick
from marl_mm.envs.task import ScriptConfig
from marl_mm.errors import MarlMmError, NonFiniteStateError, UsageError
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.model import RobotModel, RobotState
from marl_mm.robot.names import ARM_JOINTS, GRASP_FRAME
from marl_mm.sim.config import SimulationConfig
from marl_mm.sim.mujoco.model import BLOCK, GROUND, NO_SLIP
from marl_mm.sim.mujoco.world import MujocoWorld
from marl_mm.sim.scene import Block, Scene
from marl_mm.sim.world import open_world

MUJOCO = {"simulation": {"engine": "mujoco"}}


def opened(task: str = "Reach-v0", **overrides: Any) -> EpisodeCore:
    return EpisodeCore(make_task(task, MUJOCO | overrides))


def episode(
    core: EpisodeCore, seed: int, steps: int, watch: Any = None, scripted: int = 2
) -> np.ndarray:
    """All numbers of some steps, shape (steps, n), every second one of the script's.

    With ``scripted=1`` it is every one.
    """
    rng, task = np.random.default_rng(seed), core.task
    state = core.reset(rng)
    low, high = np.array(task.layout.low), np.array(task.layout.high)
    rows = []
    for number in range(steps):
        action = rng.uniform(low, high)
        if number % scripted == scripted - 1:
            seen = dict(zip(task.layout.state_names, state.tolist(), strict=True))
            wanted = task.expert(seen, ScriptConfig())
            action = np.array([wanted[name] for name in task.layout.action_names])
        step = core.step(action, watch)
        state = step.state
        numbers = [v for v in step.info.values() if not isinstance(v, str)]
        rows.append([*step.state, step.reward, *numbers])
    return np.array(rows, dtype=np.float64)


# --- The model ---------------------------------------------------------------


def test_its_dynamics_are_those_of_the_planar_model() -> None:
    world, model = (
        MujocoWorld(RobotConfig(), SimulationConfig()),
        RobotModel(RobotConfig()),
    )
    engine, data = world.model, world.data
    joints = [engine.joint(name) for name in ARM_JOINTS]
    angles = [joint.qposadr[0] for joint in joints]
    rates = [joint.dofadr[0] for joint in joints]
    rng = np.random.default_rng(0)
    for _ in range(200):
        yaw, turn = rng.uniform(-3, 3), rng.uniform(-1, 1)
        cos, sin = np.cos(yaw), np.sin(yaw)
        q = np.array([*rng.uniform(-1, 1, 2), cos, sin, *rng.uniform(-1, 1, 7)])
        v = np.array([*rng.uniform(-1, 1, 2), turn, *rng.uniform(-1, 1, 7)])
        terms = model.evaluate(RobotState(q, v))
        data.qpos[:] = 0.0
        data.qpos[:2], data.qpos[angles] = q[:2], q[4:]
        data.qpos[[3, 6]] = np.cos(yaw / 2), np.sin(yaw / 2)
        planar, change = np.zeros((engine.nv, 10)), np.zeros((engine.nv, 10))
        planar[:2, :2] = [[cos, -sin], [sin, cos]]
        change[:2, :2] = turn * np.array([[-sin, -cos], [cos, -sin]])
        planar[5, 2] = 1.0
        planar[rates, range(3, 10)] = 1.0
        data.qvel[:] = planar @ v
        mujoco.mj_forward(engine, data)
        mass = np.zeros((engine.nv, engine.nv))
        mujoco.mj_fullM(engine, data, mass)
        bias = planar.T @ (data.qfrc_bias + mass @ change @ v)
        assert np.abs(planar.T @ mass @ planar - terms.mass_matrix).max() < 1e-11
        assert np.abs(bias - terms.nonlinear).max() < 1e-11
        hand_w = data.site(GRASP_FRAME).xpos
        assert np.abs(hand_w - terms.position_w).max() < 1e-12


def test_it_stands_and_drives_on_all_its_wheels() -> None:
    """No hop, no tilt, no slip, and most of the weight on the wheels that drive."""
    world = MujocoWorld(RobotConfig(), SimulationConfig())
    world.reset()
    arm = world.data.qfrc_bias[-7:]
    for speed in 0.1 * np.sin(np.linspace(0.0, 4 * np.pi, 480)):
        world.command(speed, 0.0, arm.copy())
        world.step()
        points, forces = world.ground_forces()
        assert len(points) == 6 and (forces > 0).all(), forces
        assert np.hypot(*world.attitude()) < 1e-3
        assert abs(world.read().v[0] - speed) < 2e-3
    wheels = np.abs(points[:, 1]) > 0.21
    assert wheels.sum() == 2
    assert forces[wheels].sum() > 0.6 * forces.sum()
    assert forces.sum() == pytest.approx(world.model.body_mass.sum() * 9.81, rel=0.05)


def test_what_presses_elsewhere_is_no_force_of_the_ground() -> None:
    """The pads hold the block."""
    core = opened("CarryReach-v0")
    core.reset(np.random.default_rng(0))
    points, forces = core.drive.world.ground_forces()
    assert len(points) == len(forces) == 6
    assert (np.abs(points[:, 2]) < 1e-3).all()
    core.close()


def test_an_arm_at_work_takes_no_drive_wheel_off_the_ground() -> None:
    """Reach-v0 by its script: all wheels press, casters are unloaded at times."""
    core = opened()
    world, task = core.drive.world, core.task
    assert isinstance(world, MujocoWorld)
    wheels: list[float] = []
    tilts: list[float] = []

    def watch(tick: Tick) -> None:
        points, forces = world.ground_forces()
        _, left, _ = world.data.xmat[1].reshape(3, 3).T
        aside = np.abs((points - world.data.qpos[:3]) @ left)
        wheels.append(min(forces[aside > 0.21]))
        tilts.append(float(np.hypot(*world.attitude())))

    for seed in (0, 1):
        episode(core, seed, 6, watch)
    assert len(wheels) == 2 * 6 * task.ticks_per_step
    assert min(wheels) > 100 and max(tilts) < 1e-3


def test_no_block_falls_from_a_hand_at_rest() -> None:
    """Of any load; it creeps in the first second, by less than 0.2 mm, and no more."""
    core = opened("CarryReach-v0")
    world, still = core.drive.world, np.array([0.0, 0.0, 0.0, 1.0])

    def place() -> np.ndarray:
        block_w, _ = world.handling.block_w()
        way: np.ndarray = block_w - world.grasp_position_w()
        return way

    for seed in range(4):
        core.reset(np.random.default_rng(seed))
        places = [place()]
        for _ in range(5):
            step = core.step(still)
            places.append(place())
            assert core.drive.hand and core.drive.hand.held and not step.info["reason"]
        first, *later = np.linalg.norm(np.diff(places, axis=0), axis=1)
        assert first < 2e-4 and max(later) < 1e-5


def test_slip_is_removed_from_a_squeeze_until_the_gripper_opens() -> None:
    core = opened("Grasp-v0")
    for seed in range(2):  # of one episode nothing is left in the next
        core.reset(np.random.default_rng(seed))
        hand, world = core.drive.hand, core.drive.world
        assert isinstance(world, MujocoWorld) and hand
        option, here = world._robot.model.opt, np.zeros(3)
        for expected, act in (
            *((0, partial(hand.grip, False)), (0, partial(hand.grip, True))),
            *((NO_SLIP, partial(hand.take, here)), (NO_SLIP, partial(hand.grip, True))),
            *((0, partial(hand.grip, False)), (NO_SLIP, partial(hand.take, here))),
        ):
            act()
            assert option.noslip_iterations == expected


def test_it_stays_where_it_starts() -> None:
    core = opened()
    core.reset(np.random.default_rng(0))
    before = core.drive.state.q
    hand = core.drive.world.grasp_position_w()
    assert np.abs(hand - core.drive.start_w()).max() < 1e-3
    core.step(np.array([0.0, 0.0, 0.0, 1.0]))
    assert np.abs(core.drive.state.q - before).max() < 2e-3


# --- The compiled step -------------------------------------------------------

FORMS: list[tuple[str, dict[str, Any]]] = [
    ("Reach-v0", {}),
    ("Reach-v0", {"controller": {"form": "rhp"}}),
    ("Reach-v0", {"controller": {"form": "rhp-literal"}}),
    ("Reach-v0", {"controller": {"limits": {"zmp": True, "zmp_margin": 0.12}}}),
    ("CarryReach-v0", {}),
    ("CarryReach-v0", {"load": {"grasp": "weld", "knowledge": "given"}}),
    ("CarryReach-v0", {"load": {"knowledge": "none"}}),
    ("Grasp-v0", {}),
    ("Grasp-v0", {"load": {"grasp": "weld"}, "ticks_per_step": 111}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("task", "overrides"), FORMS, ids=str)
def test_the_compiled_step_is_the_loop_in_python(
    task: str, overrides: dict[str, Any]
) -> None:
    core = opened(task, **overrides)
    ticks: list[Tick] = []
    for seed in range(2):
        looped = episode(core, seed, core.task.max_steps, ticks.append)
        compiled = episode(core, seed, core.task.max_steps)
        np.testing.assert_allclose(compiled, looped, rtol=1e-12, atol=1e-12)
    assert len(ticks) == 2 * core.task.max_steps * core.task.ticks_per_step


@pytest.mark.slow
@pytest.mark.parametrize("task", ["Grasp-v0", "GraspReach-v0", "Course-v0"])
def test_a_block_that_is_held_keeps_them_equal(task: str) -> None:
    """Its contacts would let a last bit of the estimated mass grow."""
    core, masses = opened(task), list[float]()

    def watch(tick: Tick) -> None:
        assert core.drive.hand
        masses.append(core.drive.hand.payload.mass)

    looped = episode(core, 1, core.task.max_steps, watch, scripted=1)
    compiled = episode(core, 1, core.task.max_steps, scripted=1)
    assert max(masses) > 0.05
    np.testing.assert_allclose(compiled, looped, rtol=1e-12, atol=1e-12)


def test_ticks_without_a_solution_are_counted_alike() -> None:
    """The joints are faster than any acceleration can bring within their limits."""
    core, counted = opened(), []
    for watch in (None, lambda tick: None):
        core.reset(np.random.default_rng(0))
        world = core.drive.world
        assert isinstance(world, MujocoWorld)
        world.data.qvel[-7:] = [6.0, -6.0] * 3 + [6.0]
        core.drive.state = world.read()
        step = core.step(np.zeros(4), watch)
        counted.append([*step.state, step.info["qp_failures"], step.info["safe_ticks"]])
    assert counted[0][-1] > 10
    compiled, looped = counted
    np.testing.assert_allclose(compiled, looped, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("watch", [None, lambda tick: None], ids=["compiled", "loop"])
def test_numbers_that_are_not_finite_end_in_an_error(
    watch: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    core = opened()
    world = core.drive.world
    assert isinstance(world, MujocoWorld)
    core.reset(np.random.default_rng(0))
    core.drive.state.v[4] = np.nan
    with pytest.raises(NonFiniteStateError, match="no finite command at q = "):
        core.step(np.zeros(4), watch)
    for value in (np.inf, 1e9):  # MuJoCo warns of the second, and begins anew
        core.reset(np.random.default_rng(0))
        world.data.qvel[-1] = value
        with pytest.raises(NonFiniteStateError) as error:
            core.step(np.zeros(4), watch)
        whole = f"diverged after q = {core.drive.state.q.tolist()}, v = [0.0, 0.0, "
        assert whole in str(error.value)
    assert np.isfinite(episode(core, 0, 2)).all()  # the next episode is sound
    world.data.warning.number[1] = 1
    with pytest.raises(MarlMmError, match="warns of mjWARN_CONTACTFULL after q = "):
        core.step(np.zeros(4), watch)
    assert not list(tmp_path.iterdir()) and not "".join(capfd.readouterr())


BODY = """
import hashlib, sys
sys.path.insert(0, sys.argv[1])
from test_mujoco import episode, opened
for task in sys.argv[2:]:
    rows = [episode(opened(task), seed, 15) for seed in (3, 4, 5)]
    print(hashlib.sha256(b"".join(each.tobytes() for each in rows)).hexdigest())
"""


def digests(*tasks: str, **environment: str) -> list[bytes]:
    """Of three episodes of each task, in another process."""
    command = [sys.executable, "-c", BODY, str(Path(__file__).parent), *tasks]
    output = subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, check=True
    ).stdout.split()
    assert [len(line) for line in output] == [64] * len(tasks)
    return output


WITHOUT_AVX512 = {"OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V4"}
"""Environment variables without its kernels, whose last bits differ: of a dot product,
arccos and arctan2."""


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_kernels_of_numpy_and_blas() -> None:
    tasks = "MovingReach-v0", "Tray-v0", "Bar-v0", "Grasp-v0", "Course-v0"
    assert digests(*tasks, **WITHOUT_AVX512) == digests(*tasks)


HEADINGS = """
import numpy as np
from marl_mm.robot.model import RobotState
for angle in np.linspace(-3, 3, 500).tolist():
    q = np.array([0.0, 0.0, np.cos(angle), np.sin(angle)])
    print(RobotState(q, np.zeros(10)).yaw.hex())
"""


def test_headings_do_not_depend_on_the_kernels_of_numpy() -> None:
    """Few of an episode's would differ."""
    command = [sys.executable, "-c", HEADINGS]
    usual, without = (
        subprocess.check_output(command, env={**os.environ, **environment})
        for environment in ({}, WITHOUT_AVX512)
    )
    assert usual == without and len(usual.split()) == 500


@pytest.mark.slow
def test_bytes_are_the_same_in_processes_and_threads() -> None:
    one, two = (digests("SmoothReach-v0", OMP_NUM_THREADS=str(n)) for n in (1, 2))
    assert one == two
    cores = [opened("SmoothReach-v0") for _ in range(2)]
    with ThreadPoolExecutor(2) as pool:
        beside = list(pool.map(episode, cores, (3, 4), (6, 6)))
    for core, seed, rows in zip(cores, (3, 4), beside, strict=True):
        assert rows.tobytes() == episode(core, seed, 6).tobytes()


def test_no_clock_is_read() -> None:
    world = MujocoWorld(RobotConfig(), SimulationConfig())
    world.reset()
    world.step()
    timer = world.data.timer
    assert timer.number.any() and not timer.duration.any()


@pytest.mark.parametrize("task", ["Reach-v0", "CarryReach-v0", "Bar-v0", "Course-v0"])
def test_its_memory_is_never_nearly_full(task: str) -> None:
    """Full, MuJoCo would end the process."""
    core = opened(task)
    episode(core, 0, 4, scripted=5)  # none of them the script's
    for drive in core.drives:
        assert isinstance(drive.world, MujocoWorld)
        data = drive.world.data
        assert 1_000 < data.maxuse_arena < data.narena / 100


# --- What it cannot ----------------------------------------------------------


def test_engines_that_are_not_there_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="'brax', expected bullet or mujoco"):
        make_task("Reach-v0", {"simulation": {"engine": "brax"}})
    monkeypatch.setattr("marl_mm.sim.config.find_spec", lambda name: None)
    with pytest.raises(UsageError, match="needs the package mujoco-core"):
        open_world(RobotConfig(), SimulationConfig(engine="mujoco"))


@pytest.mark.parametrize("task", ["Reach-v0", "Grasp-v0"])
def test_it_is_drawn_where_it_is(task: str) -> None:
    """By PyBullet, whose own robot looks the same in the same place."""
    pictures = []
    for overrides in (MUJOCO, {}):
        core = EpisodeCore(make_task(task, overrides), visual=True)
        core.reset(np.random.default_rng(0))
        pictures.append(core.render(core.task.camera))
        core.step(np.resize([1.0, 0.5, 0.0, 0.0], len(core.task.layout.action)))
        pictures.append(core.render(core.task.camera))
        core.close()
    before, after, *usual = (picture.astype(float) for picture in pictures)
    assert np.abs(before - after).mean() > 0.5
    for picture, expected in zip((before, after), usual, strict=True):
        assert np.abs(picture - expected).mean() < 0.1


def test_a_window_and_pictures_without_pybullet_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(UsageError, match="has no window"):
        MujocoWorld(RobotConfig(), SimulationConfig(), gui=True)
    monkeypatch.setattr("marl_mm.sim.mujoco.world.find_spec", lambda name: None)
    with pytest.raises(UsageError, match="are drawn by PyBullet, which is"):
        MujocoWorld(RobotConfig(), SimulationConfig(), visual=True)


def test_an_order_of_constraints_that_is_not_expected_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mujoco.mjtConstraint, "mjCNSTR_FRICTION_DOF", 99)
    with pytest.raises(MarlMmError, match="orders its constraints otherwise"):
        MujocoWorld(RobotConfig(), SimulationConfig())


def test_a_block_has_the_mass_and_inertia_of_its_edges() -> None:
    """Of a cuboid: a twelfth of its mass times the squares of the other two edges.

    Another world with another block changes nothing.
    """
    world, other = (
        MujocoWorld(RobotConfig(), SimulationConfig(engine="mujoco")) for _ in range(2)
    )
    x, y, z = edges = 0.04, 0.06, 0.1
    for one, mass, friction in ((world, 2.0, 0.7), (other, 1.0, 0.5)):
        block = Block(edges, mass, friction)
        one.reset((), Scene(block, (0.7, 0.5, 0.5), (0.1, 0.1, 0.45)))
    body = world.model.body(BLOCK)
    assert body.mass.item() == 2.0
    by_hand = np.array([y**2 + z**2, x**2 + z**2, x**2 + y**2]) * 2.0 / 12
    assert body.inertia == pytest.approx(by_hand)
    assert world.model.geom(BLOCK).size == pytest.approx(np.array(edges) / 2)
    ground = world.model.pair(f"{GROUND}+{BLOCK}").id
    assert world.model.pair_friction[ground, :2].tolist() == [0.7, 0.7]


def test_levels_that_run_out_of_iterations_are_counted_each() -> None:
    """Two of every tick, by the compiled step and by the loop."""
    few = {"controller": {"hierarchy": {"iterations": 1}}, "max_steps": 2}
    task = make_task("Reach-v0", {"simulation": {"engine": "mujoco"}, **few})
    with closing(EpisodeCore(task)) as core:
        for watch in (None, lambda tick: None):
            core.reset(np.random.default_rng(0))
            info = core.step(np.array([1.0, -1.0, 1.0, 0.5]), watch).info
            assert (info["qp_failures"], info["safe_ticks"]) == (2 * 240, 240)
