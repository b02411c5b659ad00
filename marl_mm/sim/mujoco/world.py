"""The robot in MuJoCo: its model from the URDF, its state, commands and steps.

Joint frames, masses and inertias are those of the URDF. Contacts are soft in MuJoCo,
so the robot starts where they carry its weight.
"""

import ctypes
from collections.abc import Mapping, Sequence
from copy import copy
from functools import lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from marl_mm.errors import MarlMmError, UsageError
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.model import RobotState
from marl_mm.robot.names import (
    ARM_JOINTS,
    GRASP_FRAME,
    WHEEL_JOINTS,
)
from marl_mm.sim.config import RATE, Camera, SimulationConfig
from marl_mm.sim.mujoco.engine import mujoco
from marl_mm.sim.mujoco.handling import MujocoHandling
from marl_mm.sim.mujoco.model import GROUND, handling_model, robot_model
from marl_mm.sim.mujoco.native import Native, fault
from marl_mm.sim.planar import attitude, planar_state, rim_rates
from marl_mm.sim.scene import Mark, Scene
from marl_mm.sim.world import Handling

if TYPE_CHECKING:
    from marl_mm.sim.bullet.world import BulletWorld

SETTLING = 480
"""Number of steps in which the robot sinks into its contacts before the first start."""

UPRIGHT = 0.01
"""Largest tilt after it [rad]; a robot that stands has less than 0.001."""

_ORIGIN = (0.0, 0.0, 0.0)


@lru_cache(maxsize=16)
def _start(robot: RobotConfig, config: SimulationConfig) -> np.ndarray:
    """Positions of all joints in which the contacts carry the robot at rest.

    A robot that does not stand starts upright, before it falls.
    """
    robot_ = _Robot(robot_model(robot, config))
    for _ in range(SETTLING):
        robot_.joints[:], robot_.rates[:] = robot.initial_joints, 0.0
        mujoco.mj_forward(robot_.model, robot_.data)
        robot_.torque[:] = robot_.bias
        robot_.step((0.0, 0.0))
    w, x, y, z = robot_.data.qpos[3:7].tolist()
    if np.hypot(*attitude((x, y, z, w))) > UPRIGHT:
        mujoco.mj_resetData(robot_.model, robot_.data)
    robot_.joints[:] = robot.initial_joints
    start: np.ndarray = robot_.data.qpos.copy()
    start[:2] = 0.0
    _, x, y, _ = start[3:7] / start[3]
    start[3:7] = np.array([1.0, x, y, 0.0]) / np.sqrt(1.0 + x * x + y * y)  # no yaw
    return start


class _Robot:
    """A robot's data in MuJoCo, with views of what is read and commanded."""

    _word = 0
    """Place of the word that ``_pointer`` finds, in ``mjData`` [bytes]."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        arm = [model.joint(name) for name in ARM_JOINTS]
        place, rate = int(arm[0].qposadr[0]), int(arm[0].dofadr[0])
        assert [joint.dofadr[0] for joint in arm] == list(range(rate, rate + 7))
        of_arm = slice(rate, rate + 7)
        self.first = place, rate
        self.joints, self.rates = self.data.qpos[place:][:7], self.data.qvel[of_arm]
        self.torque = self.data.qfrc_applied[of_arm]
        self.bias = self.data.qfrc_bias[of_arm]
        self.wheels = [int(model.joint(name).dofadr[0]) for name in WHEEL_JOINTS]
        fingers = np.flatnonzero(model.dof_frictionloss)[len(self.wheels) :]
        self.motors = [*self.wheels, *fingers.tolist()]
        self._check_motors()
        self._aref = self._pointer(self.data.efc_aref)

    def native(self, handling: MujocoHandling | None = None) -> Native:
        """The robot as compiled code sees it."""
        data = self.data
        hand: tuple[np.ndarray, ...] = (
            np.array([0, len(self.wheels)]),
            np.zeros((2, 2), np.int64),
            np.zeros(2),
        )
        if handling is not None:
            hand = handling.rows, handling.fingers, handling.grip
        return Native(
            self.model._address,
            data._address,
            self._aref,
            data.qpos,
            data.qvel,
            self.torque,
            data.site(GRASP_FRAME).xpos,
            np.array(self.first),
            np.array(self.wheels),
            data.warning.number,
            *hand,
        )

    def _pointer(self, array: np.ndarray) -> np.ndarray:
        """Word of the ``mjData`` that points to one of its arrays, shape (1,).

        MuJoCo places arrays of constraints anew in each step, and Python has no name
        for the word; it is found by its value.
        """
        first, wanted = self.data._address, array.ctypes.data
        word = first + _Robot._word  # the same in all data: the search is made once
        while (entry := ctypes.c_uint64.from_address(word)).value != wanted:
            word += ctypes.sizeof(entry)
        _Robot._word = word - first
        return np.ctypeslib.as_array(entry).reshape(1)

    def step(self, target: Sequence[float]) -> None:
        """Advance by 1/240 s while motors have these rates [rad/s], [m/s].

        Args:
            target: Rates of the wheels, and of the fingers if they are driven.
        """
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        for row, rate in enumerate(target):
            motor = data.qvel[self.motors[row]]
            data.efc_aref[data.ne + row] = (rate - motor) * RATE
        mujoco.mj_step2(model, data)

    def _check_motors(self) -> None:
        """Raise where the first constraints are not the motors of the wheels."""
        data = self.data
        mujoco.mj_forward(self.model, data)
        friction = mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
        rows = slice(data.ne, data.ne + len(self.motors))
        kinds, numbers = data.efc_type[rows].tolist(), data.efc_id[rows].tolist()
        if kinds != [friction] * len(self.motors) or numbers != self.motors:
            raise MarlMmError(
                f"MuJoCo {mujoco.__version__} orders its constraints otherwise than "
                f"this package expects: kinds {kinds}, numbers {numbers}"
            )


def _puppet(robot: RobotConfig, config: SimulationConfig) -> "BulletWorld":
    """A robot of PyBullet that is only drawn.

    Raises:
        UsageError: If PyBullet is not installed.
    """
    if find_spec("pybullet") is None:
        raise UsageError(
            "pictures of engine 'mujoco' are drawn by PyBullet, which is not there: "
            "pip install pybullet, for which there are wheels up to Python 3.11"
        )
    from marl_mm.sim.bullet.world import BulletWorld

    return BulletWorld(robot, config, visual=True)


class MujocoWorld:
    """One robot on a plane; see ``World``.

    Args:
        robot: Mass properties and start posture.
        config: Settings of the motors and of friction.
        visual: Have PyBullet draw the robot, as MuJoCo has no renderer on the CPU.
        gui: Has to be False: there is no window.

    Raises:
        UsageError: If a window is asked for, or pictures without PyBullet.
    """

    def __init__(
        self,
        robot: RobotConfig,
        config: SimulationConfig,
        visual: bool = False,
        gui: bool = False,
    ) -> None:
        if gui:
            raise UsageError("engine 'mujoco' has no window: use engine 'bullet'")
        self._puppet = _puppet(robot, config) if visual else None
        self._configs = robot, config
        self._plain = self._robot = _Robot(robot_model(robot, config))
        self.native = self._robot.native()
        self._start = _start(robot, config)
        self._handling: MujocoHandling | None = None
        self._target = 0.0, 0.0
        self._state: RobotState | None = None

    def reset(self, marks: Sequence[Mark] = (), scene: Scene | None = None) -> None:
        """See ``World``."""
        self._handling, self._robot = None, self._plain
        if scene is not None:
            self._robot = _Robot(
                copy(handling_model(*self._configs, scene.grasp == "friction"))
            )
        model, data = self._robot.model, self._robot.data
        mujoco.mj_resetData(model, data)
        data.qpos[: len(self._start)] = self._start
        if scene is not None:
            self._handling = MujocoHandling(model, data, *self._configs, scene)
        self.native = self._robot.native(self._handling)
        self._target, self._state = (0.0, 0.0), None
        mujoco.mj_forward(model, data)
        if self._puppet is not None:
            self._puppet.reset(marks, scene)

    def read(self) -> RobotState:
        """See ``World``."""
        robot, data = self._robot, self._robot.data
        w, x, y, z = data.qpos[3:7].tolist()
        angular_w = np.empty(3)
        mujoco.mju_rotVecQuat(angular_w, data.qvel[3:6], data.qpos[3:7])
        q, v = state = RobotState(np.empty(11), np.empty(10))
        finite = planar_state(
            tuple(data.qpos[:3].tolist()),
            (x, y, z, w),
            tuple(data.qvel[:3].tolist()),
            tuple(angular_w.tolist()),
            _ORIGIN,
            tuple(robot.joints.tolist()),
            tuple(robot.rates.tolist()),
            q,
            v,
        )
        if not finite or self.native.warnings.any():
            raise fault(self.native, self._state or state)
        self._state = state
        return state

    def attitude(self) -> tuple[float, float]:
        """See ``World``."""
        w, x, y, z = self._robot.data.qpos[3:7].tolist()
        return attitude((x, y, z, w))

    def wheel_rates(self) -> tuple[float, float]:
        """See ``World``."""
        left, right = self._robot.data.qvel[self._robot.wheels].tolist()
        return left, right

    def ground_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """See ``World``."""
        model, data, force = self._robot.model, self._robot.data, np.empty(6)
        ground = model.geom(GROUND).id
        contacts = np.flatnonzero((data.contact.geom == ground).any(axis=1))
        forces = np.empty(len(contacts))
        for place, number in enumerate(contacts):
            mujoco.mj_contactForce(model, data, number, force)
            forces[place] = force[0]
        return data.contact.pos[contacts], forces

    def command(self, forward: float, yaw_rate: float, torque: np.ndarray) -> None:
        """See ``World``."""
        self._target = rim_rates(forward, yaw_rate)
        self._robot.torque[:] = torque

    def step(self) -> None:
        """See ``World``."""
        fingers = [] if self._handling is None else self._handling.motor()
        self._robot.step([*self._target, *fingers])

    @property
    def handling(self) -> Handling:
        """See ``World``."""
        assert self._handling is not None
        return self._handling

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model of the world."""
        return self._robot.model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's state of the world."""
        return self._robot.data

    def grasp_position_w(self) -> np.ndarray:
        """See ``World``."""
        data = self._robot.data
        mujoco.mj_kinematics(self._robot.model, data)  # of the state after the step
        return np.array(data.site(GRASP_FRAME).xpos)

    def move_marks(self, places: Mapping[int, Sequence[float]]) -> None:
        """See ``World``."""
        if self._puppet is not None:
            self._puppet.move_marks(places)

    def render(self, camera: Camera) -> np.ndarray:
        """See ``World``."""
        assert self._puppet is not None
        place, (w, x, y, z) = np.split(self.data.qpos[:7], [3])
        self._puppet.pose(place.tolist(), (x, y, z, w), self._robot.joints.tolist())
        if self._handling is not None:
            self._puppet.handling.pose(
                *self._handling.block_w(), self._handling.opening() / 2
            )
        return self._puppet.render(camera)

    def close(self) -> None:
        """See ``World``; MuJoCo frees its memory with the object."""
        if self._puppet is not None:
            self._puppet.close()
