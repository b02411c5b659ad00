"""The robot in PyBullet: read its state, command wheels and arm, step, render."""

import os
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from marl_mm.errors import MarlMmError, UsageError
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.model import GRAVITY, RobotState, named
from marl_mm.robot.names import (
    ARM_JOINTS,
    BASE_LINK,
    FINGER_JOINTS,
    GRASP_JOINT,
    WHEEL_JOINTS,
)
from marl_mm.sim.bullet.engine import pybullet, pybullet_data
from marl_mm.sim.bullet.handling import BulletHandling
from marl_mm.sim.bullet.model import urdf_file
from marl_mm.sim.config import RATE, Camera, SimulationConfig
from marl_mm.sim.planar import attitude, diverged, planar_state, rim_rates
from marl_mm.sim.scene import Mark, Scene

# PyBullet's values of what a mode of control does not use: positions or rates, gains.
_WHEEL_DEFAULTS = [0.0] * 2, [0.1] * 2, [1.0] * 2
_ARM_DEFAULTS = [0.0] * 7, [0.1] * 7, [1.0] * 7


class BulletWorld:
    """One robot on a plane, in a physics client of its own.

    Every reset builds the world anew: after contact, resetting the joints is not enough
    for the same bytes. A world that nothing refers to any more is closed.

    Args:
        robot: Mass properties and start posture.
        config: Settings of solver and motors.
        visual: Load the meshes, so that ``render`` and the GUI show the arm.
        gui: Open PyBullet's window.

    Raises:
        UsageError: If there is no screen for the window.
        MarlMmError: If PyBullet has no room for another world.
    """

    def __init__(
        self,
        robot: RobotConfig,
        config: SimulationConfig,
        visual: bool = False,
        gui: bool = False,
    ) -> None:
        if gui and not os.environ.get("DISPLAY"):
            raise UsageError("PyBullet's window needs a screen: $DISPLAY is not set")
        self._robot_config = robot
        self._config = config
        self._visual = visual or gui
        self._client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)
        if self._client < 0:
            raise MarlMmError(
                "PyBullet has no room for another world: close() some environments"
            )
        # PyBullet keeps 45 MB for a client until it is told to disconnect.
        self._disconnect = weakref.finalize(
            self, pybullet.disconnect, physicsClientId=self._client
        )
        self._disconnect.atexit = False  # the process's end frees it, too
        self._com_b = robot.base_com_b
        self._handling: BulletHandling | None = None

    def reset(self, marks: Sequence[Mark] = (), scene: Scene | None = None) -> None:
        """See ``World``."""
        client, config = self._client, self._config
        # A list of the few bodies is faster than a tree. With blocks it would order the
        # contacts in another way, and change last bits.
        broadphase = 0 if scene else pybullet.RESET_USE_SIMPLE_BROADPHASE
        pybullet.resetSimulation(flags=broadphase, physicsClientId=client)
        pybullet.setGravity(0, 0, -GRAVITY, physicsClientId=client)
        pybullet.setTimeStep(1 / RATE, physicsClientId=client)
        friction = scene is not None and scene.grasp == "friction"
        pybullet.setPhysicsEngineParameter(
            numSolverIterations=(
                config.grasp_iterations if friction else config.solver_iterations
            ),
            physicsClientId=client,
        )
        self._load_ground()
        links = self._load_robot(solid=scene is not None)
        self._handling = None
        if scene is not None:
            self._handling = BulletHandling(
                client, self._robot, links, self._ground, config, scene, self._visual
            )
        # Drawn things last: bodies are numbered, and contacts are in that order.
        if self._visual:
            self._draw_ground()
        self._marks = [self._draw(mark) for mark in marks if self._visual]

    def read(self) -> RobotState:
        """See ``World``."""
        client, robot = self._client, self._robot
        # By position: each keyword would cost 0.1 us.
        joints = pybullet.getJointStates(robot, self._arm, client)
        place, turn = pybullet.getBasePositionAndOrientation(robot, client)
        linear, angular = pybullet.getBaseVelocity(robot, client)
        arm, rates, _, _ = zip(*joints, strict=False)  # which costs less
        q, v = np.empty(11), np.empty(10)
        com_b = self._com_b
        if not planar_state(place, turn, linear, angular, com_b, arm, rates, q, v):
            raise diverged(q, v)
        return named(RobotState, (q, v))

    def attitude(self) -> tuple[float, float]:
        """See ``World``."""
        _, quaternion = pybullet.getBasePositionAndOrientation(
            self._robot, self._client
        )
        return attitude(quaternion)

    def wheel_rates(self) -> tuple[float, float]:
        """See ``World``."""
        left, right = pybullet.getJointStates(self._robot, self._wheels, self._client)
        return left[1], right[1]

    def ground_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """See ``World``."""
        contacts = pybullet.getContactPoints(
            self._robot, self._ground, physicsClientId=self._client
        )
        points = np.array([contact[6] for contact in contacts]).reshape(-1, 3)
        return points, np.array([contact[9] for contact in contacts])

    def command(self, forward: float, yaw_rate: float, torque: np.ndarray) -> None:
        """See ``World``."""
        robot, client = self._robot, self._client
        control = pybullet.setJointMotorControlArray  # keywords would cost 0.7 us
        mode, (none, kp, kd) = pybullet.VELOCITY_CONTROL, _WHEEL_DEFAULTS
        rates, forces = rim_rates(forward, yaw_rate), self._wheel_forces
        control(robot, self._wheels, mode, none, rates, forces, kp, kd, client)
        mode, (none, kp, kd) = pybullet.TORQUE_CONTROL, _ARM_DEFAULTS
        torques = torque.tolist()
        control(robot, self._arm, mode, none, none, torques, kp, kd, client)

    def step(self) -> None:
        """See ``World``."""
        if self._handling is not None:
            self._handling.tick()
        pybullet.stepSimulation(self._client)

    native = None
    """See ``World``."""

    @property
    def client(self) -> int:
        """PyBullet's id of this world."""
        client: int = self._client
        return client

    @property
    def handling(self) -> BulletHandling:
        """Gripper, block and stand of a world with a scene."""
        assert self._handling is not None
        return self._handling

    def grasp_position_w(self) -> np.ndarray:
        """See ``World``."""
        velocity, kinematics = 0, 1
        state = pybullet.getLinkState(
            self._robot, self._grasp, velocity, kinematics, self._client
        )
        return np.array(state[4])

    def pose(
        self, place_w: Sequence[float], turn: Sequence[float], joints: Sequence[float]
    ) -> None:
        """Put the robot somewhere, to draw it there.

        Args:
            place_w: Position of the base, shape (3,) [m].
            turn: Orientation of the base: x, y, z, w.
            joints: Angles of the arm joints, shape (7,) [rad].
        """
        client, robot = self._client, self._robot
        unturned = (0.0, 0.0, 0.0, 1.0)
        com_w, _ = pybullet.multiplyTransforms(place_w, turn, self._com_b, unturned)
        pybullet.resetBasePositionAndOrientation(
            robot, com_w, turn, physicsClientId=client
        )
        for index, angle in zip(self._arm, joints, strict=True):
            pybullet.resetJointState(robot, index, angle, 0, physicsClientId=client)

    def move_marks(self, places: Mapping[int, Sequence[float]]) -> None:
        """See ``World``."""
        for number, place_w in places.items() if self._visual else ():
            pybullet.resetBasePositionAndOrientation(
                self._marks[number], place_w, (0, 0, 0, 1), physicsClientId=self._client
            )

    def render(self, camera: Camera) -> np.ndarray:
        """Image by PyBullet's CPU renderer, shape (height, width, 3), uint8."""
        client = self._client
        view = pybullet.computeViewMatrixFromYawPitchRoll(
            camera.target_w, camera.distance, camera.yaw, camera.pitch, 0, 2
        )
        projection = pybullet.computeProjectionMatrixFOV(
            45, camera.width / camera.height, 0.1, max(10, 2 * camera.distance)
        )
        _, _, pixels, _, _ = pybullet.getCameraImage(
            camera.width,
            camera.height,
            view,
            projection,
            shadow=1,
            lightDirection=(1, -1.5, 3),
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=client,
        )
        image = np.asarray(pixels, dtype=np.uint8)
        return image.reshape(camera.height, camera.width, 4)[..., :3]

    def close(self) -> None:
        """Disconnect; closing twice is harmless."""
        self._client = -1  # the next world may get the number
        self._disconnect()

    def _load_ground(self) -> None:
        client = self._client
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_PLANE, physicsClientId=client
        )
        self._ground = pybullet.createMultiBody(0, shape, physicsClientId=client)
        # Bullet multiplies the frictions of both bodies; its default is 0.5.
        pybullet.changeDynamics(
            self._ground, -1, lateralFriction=1, physicsClientId=client
        )

    def _draw_ground(self) -> None:
        client = self._client
        data = pybullet_data.getDataPath()
        visual = pybullet.createVisualShape(
            pybullet.GEOM_MESH, fileName=f"{data}/plane.obj", physicsClientId=client
        )
        ground = pybullet.createMultiBody(
            0, baseVisualShapeIndex=visual, physicsClientId=client
        )
        checker = pybullet.loadTexture(
            f"{data}/checker_blue.png", physicsClientId=client
        )
        pybullet.changeVisualShape(
            ground,
            -1,
            textureUniqueId=checker,
            rgbaColor=[1, 1, 1, 1],
            physicsClientId=client,
        )

    def _load_robot(self, solid: bool) -> dict[str, int]:
        """Load the robot; numbers of its links by name."""
        client, config = self._client, self._config
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        if solid:
            flags |= pybullet.URDF_USE_SELF_COLLISION
            flags |= pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
        if not self._visual:
            flags |= pybullet.URDF_IGNORE_VISUAL_SHAPES
        with urdf_file(self._robot_config, solid) as name:
            # loadURDF places the link frame, unlike resetBasePositionAndOrientation.
            robot = pybullet.loadURDF(name, flags=flags, physicsClientId=client)
        self._robot = robot
        count = pybullet.getNumJoints(robot, physicsClientId=client)
        infos = [
            pybullet.getJointInfo(robot, i, physicsClientId=client)
            for i in range(count)
        ]
        index = {info[1].decode(): i for i, info in enumerate(infos)}
        self._arm = [index[name] for name in ARM_JOINTS]
        self._wheels = [index[name] for name in WHEEL_JOINTS]
        self._fingers = [index[name] for name in FINGER_JOINTS]
        self._grasp = index[GRASP_JOINT]
        self._wheel_forces = [config.wheel_force] * 2
        self._remove_hidden_friction(count)
        self._set_posture()
        links = {info[12].decode(): i for i, info in enumerate(infos)}
        return {BASE_LINK: -1, **links}

    def _remove_hidden_friction(self, count: int) -> None:
        """Set damping and friction to 0, which have no counterpart in the model."""
        for link in range(-1, count):
            pybullet.changeDynamics(
                self._robot,
                link,
                linearDamping=0,
                angularDamping=0,
                jointDamping=0,
                lateralFriction=self._config.wheel_friction * (link in self._wheels),
                spinningFriction=0,
                rollingFriction=0,
                physicsClientId=self._client,
            )

    def _set_posture(self) -> None:
        client, robot = self._client, self._robot
        posture = self._robot_config
        joints = zip(self._arm, posture.initial_joints, strict=True)
        for index, angle in joints:
            pybullet.resetJointState(robot, index, angle, 0, physicsClientId=client)
        for index in self._fingers:
            pybullet.resetJointState(
                robot, index, posture.initial_finger, 0, physicsClientId=client
            )
        # Bullet starts every joint with a velocity motor: off, so that torques act.
        pybullet.setJointMotorControlArray(
            robot,
            self._arm,
            pybullet.VELOCITY_CONTROL,
            forces=[0.0] * len(self._arm),
            physicsClientId=client,
        )
        pybullet.setJointMotorControlArray(
            robot,
            self._fingers,
            pybullet.POSITION_CONTROL,
            targetPositions=[posture.initial_finger] * 2,
            forces=[self._config.finger_force] * 2,
            physicsClientId=client,
        )

    def _draw(self, mark: Mark) -> int:
        size: dict[str, Any] = {"radius": mark.size[0]}
        kind = pybullet.GEOM_SPHERE
        if len(mark.size) == 3:
            size, kind = {"halfExtents": np.divide(mark.size, 2)}, pybullet.GEOM_BOX
        shape = pybullet.createVisualShape(
            kind, rgbaColor=mark.color, physicsClientId=self._client, **size
        )
        number: int = pybullet.createMultiBody(
            0,
            baseVisualShapeIndex=shape,
            basePosition=mark.position_w,
            physicsClientId=self._client,
        )
        return number
