"""Both engines load one URDF and agree about it."""

from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from marl_mm.control.config import ControllerConfig
from marl_mm.envs.drive import Drive
from marl_mm.errors import UsageError
from marl_mm.robot.description import BODY_SIZE, RobotConfig, urdf_xml
from marl_mm.robot.limits import robot_limits
from marl_mm.robot.model import ACTUATED, RobotModel, RobotState
from marl_mm.robot.names import ARM_JOINTS, FINGER_JOINTS, GRASP_JOINT, WHEEL_JOINTS
from marl_mm.robot.support import SUPPORT_B, support_margin
from marl_mm.sim.bullet.engine import pybullet, pybullet_data
from marl_mm.sim.config import Engine, SimulationConfig

JOINTS = WHEEL_JOINTS + ARM_JOINTS + FINGER_JOINTS


def test_numbers_of_numpy_are_numbers() -> None:
    """The URDF has their values, and equal configs are equal."""
    plain = RobotConfig(base_mass=91.0, base_com_b=(0.0, 0.0, 0.25))
    numpy = RobotConfig(
        base_mass=np.float64(91), base_com_b=tuple(np.array([0, 0, 0.25]))
    )
    assert urdf_xml(numpy) == urdf_xml(plain)
    listed: Any = [*plain.initial_joints]
    assert hash(RobotConfig(initial_joints=listed)) == hash(RobotConfig())


class Engines:
    """The whole robot, with wheels and fingers, in both engines."""

    def __init__(self, path: str) -> None:
        xml = urdf_xml(RobotConfig())
        meshes = f"{pybullet_data.getDataPath()}/franka_panda"
        with open(path, "w") as file:
            file.write(xml.replace('"franka_panda', f'"{meshes}'))
        self.client = pybullet.connect(pybullet.DIRECT)
        self.robot = pybullet.loadURDF(
            path,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=self.client,
        )
        count = pybullet.getNumJoints(self.robot, physicsClientId=self.client)
        infos = [
            pybullet.getJointInfo(self.robot, i, physicsClientId=self.client)
            for i in range(count)
        ]
        self.index = {info[1].decode(): info[0] for info in infos}
        self.moving = [i[1].decode() for i in infos if i[2] != pybullet.JOINT_FIXED]
        self.model = pin.buildModelFromXML(xml, pin.JointModelFreeFlyer())
        self.data = self.model.createData()

    def place(self, joints: dict[str, float]) -> np.ndarray:
        """Set the joints in PyBullet and return Pinocchio's configuration."""
        q: np.ndarray = pin.neutral(self.model)
        for name, value in joints.items():
            pybullet.resetJointState(
                self.robot, self.index[name], value, physicsClientId=self.client
            )
            joint = self.model.joints[self.model.getJointId(name)]
            at = joint.idx_q
            if joint.nq == 2:  # a continuous joint is cos, sin
                q[at : at + 2] = np.cos(value), np.sin(value)
            else:
                q[at] = value
        return q

    def velocity_index(self, name: str) -> int:
        return int(self.model.joints[self.model.getJointId(name)].idx_v)

    def random_joints(self, rng: np.random.Generator) -> dict[str, float]:
        limits = robot_limits(RobotConfig())
        arm = rng.uniform(limits.lower, limits.upper)
        values = [*rng.uniform(-3, 3, 2), *arm, *rng.uniform(0, 0.04, 2)]
        return dict(zip(JOINTS, map(float, values), strict=True))


@pytest.fixture(scope="module")
def engines(tmp_path_factory: pytest.TempPathFactory) -> Engines:
    return Engines(str(tmp_path_factory.mktemp("robot") / "robot.urdf"))


def test_total_mass_agrees_and_is_the_data_sheets(engines: Engines) -> None:
    links = range(-1, len(engines.index))
    mass = sum(
        pybullet.getDynamicsInfo(engines.robot, i, physicsClientId=engines.client)[0]
        for i in links
    )
    assert mass == pytest.approx(pin.computeTotalMass(engines.model), abs=1e-9)
    base, arm, hand, fingers, frame = 84.0, 2.814203 + 16.062132, 0.73, 0.03, 0.001
    assert mass == pytest.approx(base + arm + hand + fingers + frame, abs=1e-6)


def test_forward_kinematics_agrees_at_50_configurations(engines: Engines) -> None:
    rng = np.random.default_rng(0)
    frame = engines.model.getFrameId("grasp")
    for _ in range(50):
        q = engines.place(engines.random_joints(rng))
        pin.framesForwardKinematics(engines.model, engines.data, q)
        expected = engines.data.oMf[frame]
        state = pybullet.getLinkState(
            engines.robot,
            engines.index[GRASP_JOINT],
            computeForwardKinematics=True,
            physicsClientId=engines.client,
        )
        rotation = np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
        np.testing.assert_allclose(state[4], expected.translation, atol=1e-6)
        np.testing.assert_allclose(rotation, expected.rotation, atol=1e-6)


def test_mass_matrix_agrees_at_50_configurations(engines: Engines) -> None:
    """All of it, base coupling included: PyBullet's base velocity is (angular, linear)
    of the centre of mass, Pinocchio's (linear, angular) of the base frame."""
    rng = np.random.default_rng(1)
    columns = [*range(6), *(engines.velocity_index(name) for name in engines.moving)]
    to_frame = np.eye(len(columns))
    to_frame[:6, :6] = 0
    to_frame[:3, 3:6] = np.eye(3)
    to_frame[3:6, :3] = np.eye(3)
    to_frame[:3, :3] = pin.skew(np.array(RobotConfig().base_com_b))
    for _ in range(50):
        joints = engines.random_joints(rng)
        q = engines.place(joints)
        crba = pin.crba(engines.model, engines.data, q)
        expected = to_frame.T @ crba[np.ix_(columns, columns)] @ to_frame
        positions = [joints[name] for name in engines.moving]
        actual = pybullet.calculateMassMatrix(
            engines.robot, positions, physicsClientId=engines.client
        )
        np.testing.assert_allclose(actual, expected, atol=1e-6)


def test_gravity_torque_agrees_at_50_configurations(engines: Engines) -> None:
    rng = np.random.default_rng(2)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=engines.client)
    for _ in range(50):
        joints = engines.random_joints(rng)
        q = engines.place(joints)
        nothing = np.zeros(engines.model.nv)
        expected = pin.rnea(engines.model, engines.data, q, nothing, nothing)
        position, quaternion = pybullet.getBasePositionAndOrientation(
            engines.robot, physicsClientId=engines.client
        )
        positions = [joints[name] for name in engines.moving]
        zeros = [0.0] * (6 + len(positions))
        torque = pybullet.calculateInverseDynamics(
            engines.robot,
            [*position, *quaternion, *positions],
            zeros,
            zeros,
            physicsClientId=engines.client,
        )
        for name, value in zip(engines.moving, torque[6:], strict=True):
            at = engines.velocity_index(name)
            assert value == pytest.approx(expected[at], abs=1e-5), name


def test_initial_posture_puts_the_hand_where_the_design_says() -> None:
    robot = RobotConfig()
    q = np.array([0, 0, 1, 0, *robot.initial_joints], dtype=float)
    terms = RobotModel(robot).evaluate(RobotState(q, np.zeros(10)))
    np.testing.assert_allclose(terms.position_w, (0.647, 0.100, 0.585), atol=2e-3)


@pytest.mark.parametrize("engine", ["mujoco", "bullet"])
def test_a_posture_beyond_the_limits_is_refused(engine: Engine) -> None:
    bent = RobotConfig(initial_joints=(0.0, -0.215, 0.0, 0.1, 0.0, 2.356, 2.356))
    complaint = "panda_joint4 at 0.1 rad, expected -3.0718 to -0.0698"
    with pytest.raises(UsageError, match=complaint):
        Drive(bent, SimulationConfig(engine=engine), ControllerConfig())
    wide = RobotConfig(initial_finger=0.1)
    with pytest.raises(UsageError, match=r"initial_finger is 0.1, expected 0 to 0.04"):
        Drive(wide, SimulationConfig(engine=engine), ControllerConfig())


def test_base_inertia_follows_the_config() -> None:
    heavy = RobotConfig(base_mass=164.0, base_com_b=(0.05, 0.0, 0.15))
    xml = urdf_xml(heavy)
    model = pin.buildModelFromXML(xml, pin.JointModelFreeFlyer())
    light = pin.buildModelFromXML(urdf_xml(RobotConfig()), pin.JointModelFreeFlyer())
    added = pin.computeTotalMass(model) - pin.computeTotalMass(light)
    assert added == pytest.approx(82.0)
    parts = ElementTree.fromstring(xml).iterfind(".//*[@name='base_link']/inertial/*")
    inertial = {part.tag: part.attrib for part in parts}
    length, width, height = np.square(BODY_SIZE)
    moments = 164.0 / 12 * np.array([width + height, length + height, length + width])
    found = [float(inertial["inertia"][name]) for name in ("ixx", "iyy", "izz")]
    np.testing.assert_allclose(found, moments)
    place = inertial["origin"]["xyz"].split()
    assert tuple(map(float, place)) == heavy.base_com_b


def test_jacobian_is_the_derivative_of_the_hand_position() -> None:
    rng = np.random.default_rng(3)
    robot = RobotConfig()
    model = RobotModel(robot)
    for _ in range(10):
        yaw = rng.uniform(-3, 3)
        joints = np.array(robot.initial_joints) + rng.normal(0, 0.3, 7)
        v = np.zeros(10)
        v[ACTUATED] = rng.normal(size=9)
        step = 1e-6

        def at(
            time: float, yaw: float, joints: np.ndarray, v: np.ndarray
        ) -> RobotState:
            turned = yaw + time * v[2]
            # Midpoint heading: exact to second order for a base that turns.
            middle = yaw + time * v[2] / 2
            x, y = time * v[0] * np.cos(middle), time * v[0] * np.sin(middle)
            q = np.array(
                [x, y, np.cos(turned), np.sin(turned), *(joints + time * v[3:])]
            )
            return RobotState(q, v)

        here = model.evaluate(at(0.0, yaw, joints, v))
        velocity, jacobian = here.velocity_w.copy(), here.jacobian.copy()
        bias = here.bias_acceleration.copy()
        ahead = model.evaluate(at(step, yaw, joints, v))
        position_ahead, velocity_ahead = (
            ahead.position_w.copy(),
            ahead.velocity_w.copy(),
        )
        behind = model.evaluate(at(-step, yaw, joints, v))
        numeric = (position_ahead - behind.position_w) / (2 * step)
        acceleration = (velocity_ahead - behind.velocity_w) / (2 * step)
        np.testing.assert_allclose(jacobian @ v, velocity, atol=1e-12)
        np.testing.assert_allclose(velocity[:3], numeric, atol=1e-7)
        # v is constant along the path, so all acceleration is the bias Jdot v.
        np.testing.assert_allclose(bias, acceleration, atol=1e-6)


def test_support_margin_is_the_distance_to_the_nearest_edge() -> None:
    assert support_margin(np.array([-0.27 + 0.05, 0.0])) == pytest.approx(0.05)
    assert support_margin(np.array([-0.27 - 0.05, 0.0])) == pytest.approx(-0.05)
    for corner in SUPPORT_B:
        assert support_margin(corner) == pytest.approx(0.0, abs=1e-12)
