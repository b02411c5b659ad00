"""Driven into each limit, the robot in the simulator keeps it.

Tasks that are no part of a hierarchy leave the others free to ask for anything: here
they ask for what no limit allows, and the engine shows what the robot did.
"""

from collections.abc import Callable

import numpy as np
import pytest

from marl_mm.control.config import ControllerConfig, Gains, LimitConfig
from marl_mm.control.priorities import LEFT_OUT, REACHING_LEVELS, cumulative
from marl_mm.control.records import Priorities, Reference
from marl_mm.envs.drive import Drive, Motion, Tick, wheel_slip
from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError
from marl_mm.eval.bench.abuse import abuse
from marl_mm.robot.description import WHEEL_RADIUS, RobotConfig
from marl_mm.robot.model import ACTUATED, RobotState
from marl_mm.robot.support import support_margin
from marl_mm.sim.bullet.world import BulletWorld
from marl_mm.sim.config import ENGINES, RATE, Engine, SimulationConfig
from marl_mm.sim.mujoco.world import MujocoWorld
from marl_mm.sim.world import check_engine

BASE_AND_POSTURE = (1, 1, LEFT_OUT, LEFT_OUT, 2)
"""Levels without the hand's tasks."""

MEASURED = 1.05
"""Accelerations are differences of the simulator's speeds over one tick."""

DEPTH = 5.1e-5
"""Depth to which MuJoCo's soft contacts let the drive wheels sink [m]. They roll on a
radius that is shorter by half of it; as commands add to the measured speed of the base,
a tick in which it begins to brake takes away the rims' lead over it, too."""

ROTORS = 2 * 0.04 / WHEEL_RADIUS
"""Moment of both wheels with their motors' rotors about the axle, which the
controller's model lacks, per acceleration of the base [N m s^2/m] (miranda.urdf)."""

SETTLING = 3
"""Ticks after a reset in which the contacts and the fingers' motors settle."""


class Record:
    """States and commands of a run, and the centre of pressure under the robot."""

    motion: Motion

    def __init__(self, drive: Drive) -> None:
        self.drive = drive
        self.limits = drive.limits
        self.ticks: list[Tick] = []
        self.pressure_b: list[np.ndarray] = []
        self.rims: list[tuple[float, float]] = []

    def see(self, tick: Tick) -> None:
        self.ticks.append(tick)
        self.rims.append(self.drive.world.wheel_rates())
        points, forces = self.drive.world.ground_forces()
        self.weight = forces.sum()
        x, y = forces @ points[:, :2] / (self.weight or 1.0) - tick.state.q[:2]
        cos, sin = tick.state.q[2:4]
        self.pressure_b.append(np.array([cos * x + sin * y, cos * y - sin * x]))

    @property
    def arm(self) -> np.ndarray:
        return np.array([tick.state.q[4:] for tick in self.ticks])

    @property
    def velocity(self) -> np.ndarray:
        return np.array([tick.state.v[ACTUATED] for tick in self.ticks])

    @property
    def acceleration(self) -> np.ndarray:
        return np.diff(self.velocity, axis=0)[SETTLING:] * RATE

    @property
    def torque(self) -> np.ndarray:
        """M u + h of the arm, before the command is clipped, shape (ticks, 7)."""
        torques = []
        for tick in self.ticks:
            terms = self.drive.model.evaluate(tick.state)
            inertia = terms.mass_matrix[3:, ACTUATED]
            torques.append(inertia @ tick.command.acceleration + terms.nonlinear[3:])
        return np.array(torques)


def run(
    change: Callable[[int, Reference], Reference],
    levels: tuple[int, ...],
    seconds: float,
    controller: ControllerConfig | None = None,
    robot: RobotConfig | None = None,
    simulation: SimulationConfig | None = None,
) -> Record:
    """Follow the start posture, changed tick by tick; forces under the robot, too."""
    robot = robot or RobotConfig()
    simulation = simulation or SimulationConfig()
    drive = Drive(robot, simulation, controller or ControllerConfig())
    start = drive.reset()
    terms = drive.model.evaluate(start)
    rest = Reference(
        terms.position_w.copy(),
        np.ascontiguousarray(terms.rotation_w).copy(),
        start.q[:2].copy(),
        0.0,
        0.0,
        np.array(robot.initial_joints),
    )
    record = Record(drive)

    def reference_at(k: int, state: RobotState) -> Reference:
        return change(k, rest._replace(base_position_w=state.q[:2]))

    priorities = Priorities(cumulative(levels)[None], np.ones(1))
    ticks = round(seconds * RATE)
    record.motion = drive.follow(reference_at, priorities, ticks, 2, record.see)
    drive.close()
    return record


@pytest.mark.slow
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("joint", range(7))
def test_a_joint_driven_beyond_its_range(joint: int, side: int) -> None:
    """As fast as it may, to where it may not go: position, speed, torque hold."""
    gains = Gains(posture_rate=12)

    def beyond(k: int, rest: Reference) -> Reference:
        posture = rest.posture.copy()
        posture[joint] += side * 8.0
        return rest._replace(posture=posture)

    record = run(beyond, BASE_AND_POSTURE, 4, ControllerConfig(gains=gains))
    limits = record.limits
    arm, speed = record.arm, np.abs(record.velocity[:, 2:])
    assert (arm < limits.upper).all()
    assert (arm > limits.lower).all()
    bound = limits.upper if side > 0 else limits.lower
    assert abs(arm[-1, joint] - bound[joint]) < 0.03, "it was not driven there"
    assert (speed <= limits.speed[2:]).all()
    assert (np.abs(record.torque) <= limits.torque + 1e-6).all()
    share = np.abs(record.acceleration[:, 2:]) / limits.acceleration[2:]
    assert share.max() < MEASURED


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "mass", "iterations", "share"),
    [
        ("bullet", 82, 20, 0.95),
        ("bullet", 160, 20, 0.94),
        ("bullet", 500, 20, 0.54),
        ("bullet", 500, 200, 0.87),
        ("mujoco", 160, 20, 0.94),
        ("mujoco", 500, 20, 0.86),
    ],
)
def test_a_heavy_base_lags_as_its_page_says(
    engine: Engine, mass: float, iterations: int, share: float
) -> None:
    """Half a second after 0.2 m/s is commanded; see docs/howto/robot.md."""
    check_engine(engine)

    def ahead(k: int, rest: Reference) -> Reference:
        return rest._replace(base_speed=0.2)

    simulation = SimulationConfig(engine=engine, solver_iterations=iterations)
    robot = RobotConfig(base_mass=mass)
    record = run(ahead, BASE_AND_POSTURE, 0.5, robot=robot, simulation=simulation)
    assert record.velocity[-1, 0] / 0.2 == pytest.approx(share, abs=0.01)


def test_joints_reach_their_speed_limit_and_no_more() -> None:
    """Joint 1 swings through its whole range, twice."""

    def swing(k: int, rest: Reference) -> Reference:
        posture = rest.posture.copy()
        posture[0] = 8.0 if (k // 720) % 2 == 0 else -8.0
        return rest._replace(posture=posture)

    gains = Gains(posture_rate=12)
    record = run(swing, BASE_AND_POSTURE, 9, ControllerConfig(gains=gains))
    fastest = np.abs(record.velocity[:, 2]).max() / record.limits.speed[2]
    assert 0.96 < fastest <= 1


def test_a_weak_arm_keeps_its_torque(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 80 % of its torque it swings up and down: the QP's torque rows are active."""
    robot = RobotConfig()
    drive = Drive(robot, SimulationConfig(), ControllerConfig())
    weak = drive.limits._replace(torque=0.8 * drive.limits.torque)
    drive.close()

    def wave(k: int, rest: Reference) -> Reference:
        posture = rest.posture.copy()
        posture[1] = 1.7 if (k // 360) % 2 == 0 else -1.7
        posture[3] = -0.1
        return rest._replace(posture=posture)

    monkeypatch.setattr("marl_mm.envs.drive.robot_limits", lambda config: weak)
    gains = Gains(posture_rate=12)
    record = run(wave, BASE_AND_POSTURE, 6, ControllerConfig(gains=gains))
    share = np.abs(record.torque) / weak.torque
    assert record.motion.safe_ticks == 0
    assert 0.99 < share.max() <= 1 + 1e-6


def test_base_speed_and_acceleration() -> None:
    def dash(k: int, rest: Reference) -> Reference:
        return rest._replace(base_speed=3.0 if (k // 480) % 2 == 0 else -3.0)

    record = run(dash, BASE_AND_POSTURE, 6)
    speed, limits = np.abs(record.velocity[:, 0]), record.limits
    assert 0.97 < speed.max() <= limits.speed[0]
    acceleration = np.abs(record.acceleration[:, 0])
    assert 0.9 * limits.acceleration[0] < acceleration.max()
    assert acceleration.max() < MEASURED * limits.acceleration[0]


def test_wheels_that_sink_roll_on_a_shorter_radius() -> None:
    """On MuJoCo the rims are ahead of the base by half the depth over the radius."""
    world = MujocoWorld(RobotConfig(), SimulationConfig(engine="mujoco"))
    world.reset()
    for k in range(480):
        bias = world.data.qfrc_bias[-7:]
        world.command(min(0.8, k / RATE), 0.0, bias)
        world.step()
    depth = -np.mean(world.data.contact.dist[-2:])
    rims = WHEEL_RADIUS * np.mean(world.wheel_rates())
    lead = rims / world.read().v[0] - 1
    assert lead == pytest.approx(depth / (2 * WHEEL_RADIUS), rel=0.02)
    assert depth < DEPTH


@pytest.mark.parametrize("engine", ENGINES)
def test_base_yaw_rate_and_acceleration(engine: Engine) -> None:
    def turn(k: int, rest: Reference) -> Reference:
        return rest._replace(base_heading=3.0 if (k // 480) % 2 == 0 else -0.1)

    gains = Gains(heading_rate=12)
    control, simulation = ControllerConfig(gains=gains), SimulationConfig(engine=engine)
    record = run(turn, BASE_AND_POSTURE, 6, control, simulation=simulation)
    rate, limits = np.abs(record.velocity[:, 1]), record.limits
    assert 0.96 * limits.speed[1] < rate.max() <= limits.speed[1]
    acceleration = np.abs(record.acceleration[:, 1])
    assert 0.9 * limits.acceleration[1] < acceleration.max()
    most = MEASURED * limits.acceleration[1]
    if engine == "mujoco":
        lead = limits.speed[1] * DEPTH / (2 * WHEEL_RADIUS)
        most = limits.acceleration[1] + lead * RATE
    assert acceleration.max() < most


def test_wheel_speed() -> None:
    """Full speed and full turn together are more than a wheel can do."""

    def curve(k: int, rest: Reference) -> Reference:
        return rest._replace(base_speed=3.0, base_heading=0.02 * k)

    gains = Gains(heading_rate=8)
    record = run(curve, BASE_AND_POSTURE, 5, ControllerConfig(gains=gains))
    rates, most = np.abs(record.rims), record.limits.wheel_speed
    assert 0.97 * most < rates.max() <= most


def test_keep_out_plane() -> None:
    """The hand is asked into its own column, and stops ahead of it."""

    def into_the_column(k: int, rest: Reference) -> Reference:
        return rest._replace(ee_position_w=np.array([0.0, 0.1, 0.6]))

    record = run(into_the_column, REACHING_LEVELS, 4)
    ahead = []
    for tick in record.ticks:
        terms = record.drive.model.evaluate(tick.state)
        ahead.append(tick.state.q[2:4] @ (terms.position_w[:2] - tick.state.q[:2]))
    plane = LimitConfig().keep_out
    assert min(ahead) > plane - 0.005
    assert min(ahead) < plane + 0.02, "it was not driven there"


TOP_HEAVY = RobotConfig(base_mass=40.0, base_com_b=(0.0, 0.0, 0.45))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("on", [False, True])
def test_zero_moment_point(on: bool, engine: Engine) -> None:
    """A light base with a high centre of mass brakes hard, with the arm stretched.

    The centre of pressure under it, from the simulator's contact forces, keeps the
    margin if the limit is on, and passes it if not. The rotors move it on MuJoCo, which
    brakes as asked for; PyBullet's wheels give 0.97 of an acceleration, and that the
    rotors' share of it.
    """
    margin = 0.12
    limits = LimitConfig(zmp=on, zmp_margin=margin)

    def dash(k: int, rest: Reference) -> Reference:
        posture = rest.posture.copy()
        posture[1], posture[3] = 0.9, -1.2
        ahead = (k // 360) % 2 == 0
        return rest._replace(base_speed=0.8 if ahead else -0.8, posture=posture)

    control, simulation = (
        ControllerConfig(limits=limits),
        SimulationConfig(engine=engine),
    )
    record = run(dash, BASE_AND_POSTURE, 6, control, TOP_HEAVY, simulation)
    margins = [support_margin(point) for point in record.pressure_b[24:]]
    moved = 0.0
    if engine == "mujoco":
        moved = ROTORS * record.limits.acceleration[0] / record.weight
    if on:
        assert min(margins) > margin - 0.005 - moved
    else:
        assert min(margins) < margin - 0.01 - moved


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("forward", [1, -1])
def test_a_base_on_its_nose_or_back_is_seen(
    forward: int, engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With its mass beyond the casters it falls; forward its pitch is positive.

    (Braking cannot do that: it takes the load, and so the grip, off the wheels.) Such a
    robot is refused, but where a test asks for it.
    """
    heavy = RobotConfig(base_mass=60.0, base_com_b=(0.6 * forward, 0.0, 0.3))
    simulation = SimulationConfig(engine=engine)
    check_engine(engine)  # the test is skipped without it
    with pytest.raises(UsageError, match="m inside the edge of its wheels' support"):
        Drive(heavy, simulation, ControllerConfig())
    monkeypatch.setattr(Drive, "_check_balance", lambda drive, controller: None)
    record = run(
        lambda k, rest: rest,
        BASE_AND_POSTURE,
        0.5,
        robot=heavy,
        simulation=simulation,
    )
    motion, first = record.motion, record.ticks[0].state
    assert (first.q[:4] == (0, 0, 1, 0)).all(), "it has fallen before it starts"
    assert motion.zmp_margin < 0
    assert 0.02 < forward * motion.base_pitch <= motion.tilt
    assert motion.model_ee_error > 0.01


def test_wheels_grip() -> None:
    """Targets flung every second: no slip, no tilt, and the model stays true."""
    rng = np.random.default_rng(0)
    targets = rng.uniform((0.4, -0.8, 0.3), (1.2, 0.8, 1.1), (6, 3))

    def fling(k: int, rest: Reference) -> Reference:
        return rest._replace(ee_position_w=targets[k // RATE])

    motion = run(fling, REACHING_LEVELS, 6).motion
    assert motion.wheel_slip < 0.02
    assert motion.tilt < 1e-3
    assert motion.model_ee_error < 1e-3


@pytest.mark.slow
def test_traction_rows_are_what_keeps_the_joints_accelerations() -> None:
    """Without them the base gives way under a flung arm, in single ticks by a third."""
    excess = {}
    for traction in (LimitConfig().traction, 1e6):
        limits = {"controller": {"limits": {"traction": traction}}}
        result = abuse(make_task("Reach-v0", limits), 12_000, seed=6)
        worst = result["worst_excess"]
        excess[traction] = worst["measured_joint_acceleration_share"]
    assert excess[LimitConfig().traction] < 0.15
    assert excess[1e6] > 0.3


def test_slip_by_hand() -> None:
    """Rims at 1.0 and 1.5 m/s over a base that moves at 1.2 and turns at 0.5 rad/s."""
    v = np.zeros(10)
    v[0], v[2] = 1.2, 0.5
    state = RobotState(np.zeros(11), v)
    rates = (1.0 / WHEEL_RADIUS, 1.5 / WHEEL_RADIUS)
    expected = 1.5 - (1.2 + 0.5 * 0.2226)
    assert wheel_slip(state, rates) == pytest.approx(expected)


def test_spinning_wheels_are_seen() -> None:
    """On ice the wheels reach 0.5 m/s at once, and the base does not."""
    world = BulletWorld(RobotConfig(), SimulationConfig(wheel_friction=0.02))
    world.reset()
    for _ in range(24):
        world.command(0.5, 0.0, np.zeros(7))
        world.step()
    assert wheel_slip(world.read(), world.wheel_rates()) > 0.3
    world.close()
