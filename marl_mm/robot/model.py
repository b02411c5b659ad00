"""The rigid-body model the controller sees: a planar base that carries the arm.

Configuration q, shape (11,): x, y [m], cos(yaw), sin(yaw), arm joints [rad]. Velocity
v, shape (10,): forward and lateral speed in the base frame [m/s], yaw rate [rad/s], arm
joints [rad/s]. Wheels and fingers are locked; a differential drive never moves
sideways, so the controller leaves the lateral column out.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from marl_mm.robot.description import RobotConfig, urdf_xml
from marl_mm.robot.names import FINGER_JOINTS, GRASP_FRAME, WHEEL_JOINTS

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2]."""

ACTUATED = np.array([0, 2, 3, 4, 5, 6, 7, 8, 9])
"""Entries of v the controller moves: all but the lateral one, shape (9,)."""

_WORLD = pin.LOCAL_WORLD_ALIGNED

named = tuple.__new__
"""Makes a named tuple of its values, in 0.6 of its constructor's time."""


class RobotState(NamedTuple):
    """Configuration and velocity of the robot at one instant."""

    q: np.ndarray
    """Configuration, shape (11,)."""

    v: np.ndarray
    """Velocity, shape (10,)."""

    @property
    def yaw(self) -> float:
        """Heading of the base in the world [rad]."""
        return math.atan2(self.q[3], self.q[2])  # NumPy's depends on the processor


class ModelTerms(NamedTuple):
    """Kinematics and dynamics at one state, in the axes of the world."""

    position_w: np.ndarray
    """Position of the end-effector, shape (3,) [m]."""

    rotation_w: np.ndarray
    """Axes of the end-effector as columns, shape (3, 3)."""

    velocity_w: np.ndarray
    """Velocity of the end-effector, shape (6,): linear [m/s], angular [rad/s]."""

    jacobian: np.ndarray
    """Jacobian of the end-effector, shape (6, 10): linear rows, then angular."""

    bias_acceleration: np.ndarray
    """Rate of the Jacobian times v, shape (6,) [m/s^2], [rad/s^2]."""

    mass_matrix: np.ndarray
    """Mass matrix, both triangles filled, shape (10, 10)."""

    nonlinear: np.ndarray
    """Coriolis, centrifugal and gravity forces, shape (10,) [N], [N m]."""

    wrench: np.ndarray
    """Wrench of the ground about the base's origin, shape (6, 11): rows of force [N],
    then moment [N m]. A column per acceleration, and a last one at zero acceleration.
    All zero unless the model evaluates balance."""


class RobotModel:
    """Pinocchio's planar model of the robot, evaluated once per controller tick.

    Args:
        config: Mass properties.
        balance: Whether to evaluate the ground's wrench, too.
    """

    def __init__(self, config: RobotConfig, balance: bool = False) -> None:
        full = pin.buildModelFromXML(urdf_xml(config), pin.JointModelPlanar())
        home = pin.neutral(full)
        for finger in FINGER_JOINTS:
            home[full.joints[full.getJointId(finger)].idx_q] = config.initial_finger
        locked = [full.getJointId(name) for name in WHEEL_JOINTS + FINGER_JOINTS]
        self._model = pin.buildReducedModel(full, locked, home)
        self._data = self._model.createData()
        self._frame = self._model.getFrameId(GRASP_FRAME)
        placement = self._data.oMf[self._frame]
        # Views of the data, which stay where they are.
        self._pose = placement.translation, placement.rotation
        self._com, self._momentum_rate = self._data.com[0], self._data.dhg
        self._no_acceleration = np.zeros(self._model.nv)
        self._full = np.zeros(self._model.nv)
        self._mass = pin.computeTotalMass(self._model)
        grasp = self._model.frames[self._frame]
        self._hand, self._grasp_h = grasp.parentJoint, grasp.placement
        self._empty = pin.Inertia(self._model.inertias[self._hand])
        self._balance = balance
        self._wrench = np.zeros((6, self._model.nv + 1))

    def carry(self, mass: float, size: tuple[float, float, float]) -> None:
        """Count a load at the grasp point as part of the hand from now on.

        Args:
            mass: Mass of the load [kg]; 0 empties the hand.
            size: Edges of the cuboid whose inertia it has [m].
        """
        load = self._grasp_h.act(pin.Inertia.FromBox(mass, *size))
        self._model.inertias[self._hand] = self._empty + load if mass else self._empty
        self._mass = pin.computeTotalMass(self._model)

    @property
    def pinocchio(self) -> Any:
        """Pinocchio's own model: planar root joint, wheels and fingers locked."""
        return self._model

    def evaluate(self, state: RobotState) -> ModelTerms:
        """Kinematics and dynamics at ``state``.

        The arrays may share memory with the model: they hold until the next call.
        """
        model, data, frame = self._model, self._data, self._frame
        q, v = state
        if self._balance:
            self._evaluate_ground(state)
        pin.forwardKinematics(model, data, q, v, self._no_acceleration)
        pin.computeJointJacobians(model, data)
        pin.updateFramePlacement(model, data, frame)
        acceleration = pin.getFrameClassicalAcceleration(model, data, frame, _WORLD)
        values = (
            *self._pose,
            pin.getFrameVelocity(model, data, frame, _WORLD).vector,
            pin.getFrameJacobian(model, data, frame, _WORLD),
            acceleration.vector,
            pin.crba(model, data, q),
            pin.nonLinearEffects(model, data, q, v),
            self._wrench,
        )
        return named(ModelTerms, values)

    def _evaluate_ground(self, state: RobotState) -> None:
        """Write the wrench: rate of centroidal momentum less gravity, at the base."""
        model, data, wrench = self._model, self._data, self._wrench
        pin.computeCentroidalMomentumTimeVariation(
            model, data, state.q, state.v, self._no_acceleration
        )
        wrench[:, -1] = self._momentum_rate.vector
        wrench[2, -1] += self._mass * GRAVITY
        wrench[:, :-1] = pin.computeCentroidalMap(model, data, state.q)
        arm = self._com - np.array([state.q[0], state.q[1], 0.0])
        wrench[3:] += np.cross(arm, wrench[:3], axisb=0, axisc=0)

    def zmp_b(self, state: RobotState, acceleration: np.ndarray) -> np.ndarray:
        """Zero-moment point on the ground in the base frame, shape (2,) [m].

        Args:
            state: State of the robot.
            acceleration: Controller's variables u, shape (9,).
        """
        model, data, full = self._model, self._data, self._full
        full[0], full[2:] = acceleration[0], acceleration[1:]
        pin.computeCentroidalMomentumTimeVariation(model, data, *state, full)
        x, y, z = self._com.tolist()
        fx, fy, fz, mx, my, _ = self._momentum_rate.vector.tolist()
        vertical = self._mass * GRAVITY + fz
        base_x, base_y, cos, sin = state.q[:4].tolist()
        x = x - (z * fx + my) / vertical - base_x
        y = y - (z * fy - mx) / vertical - base_y
        return np.array([cos * x + sin * y, -sin * x + cos * y])
