"""The planar model in compiled form: the numbers of ``RobotModel`` without Pinocchio.

Vectors are in the axes of the world, and points relative to the base's origin O, which
lies on the ground. Velocities go from the base to the hand, forces the other way, of
composite bodies (Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 5 and 6).
"""

from typing import Any, NamedTuple

import numpy as np

from marl_mm.jit import jit
from marl_mm.robot.bodies import BODIES, HAND, Bodies, load_hand
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.model import GRAVITY, ModelTerms, RobotModel, RobotState
from marl_mm.robot.vectors import (
    Symmetric,
    Vector,
    added,
    cross,
    dot,
    halves,
    scaled,
    times,
    turned,
    vector,
)


class Scratch(NamedTuple):
    """Memory of ``planar_terms``, which allocates none."""

    rotation: np.ndarray
    """Axes of the bodies as columns, shape (8, 3, 3)."""

    place: np.ndarray
    """Origins of the bodies, shape (8, 3) [m]."""

    motion: np.ndarray
    """Velocity at O per unit of v, shape (10, 6): linear, then angular."""

    mass: np.ndarray
    """Masses of the composite bodies, shape (8,) [kg]."""

    moment: np.ndarray
    """First moments of mass of the composite bodies, shape (8, 3) [kg m]."""

    inertia: np.ndarray
    """Inertias about O of the composite bodies, shape (8, 6): xx, xy, xz, yy, yz, zz
    [kg m^2]."""

    force: np.ndarray
    """Wrenches at O that move the composite bodies, shape (8, 6) [N], [N m]."""


class PlanarModel(RobotModel):
    """``RobotModel`` whose numbers are computed in compiled code.

    It agrees with Pinocchio to rounding, and always evaluates the ground's wrench.

    Args:
        config: Mass properties.
    """

    def __init__(self, config: RobotConfig) -> None:
        super().__init__(config)
        model = self.pinocchio
        inertias = list(model.inertias)[1:]
        places = list(model.jointPlacements)[1:]
        self.bodies = Bodies(
            np.array([inertia.mass for inertia in inertias]),
            np.array([inertia.lever for inertia in inertias]),
            np.array([inertia.inertia for inertia in inertias]),
            np.array([place.rotation for place in places]),
            np.array([place.translation for place in places]),
            np.array(self._grasp_h.rotation, order="C"),
            np.array(self._grasp_h.translation),
        )
        self.empty = (
            self.bodies.mass[HAND].item(),
            self.bodies.com[HAND].copy(),
            self.bodies.inertia[HAND].copy(),
        )
        self.scratch = new_scratch()
        self.terms = new_terms()
        self.truth = new_terms()
        """Memory for the terms of ``zmp_b``: those of ``evaluate`` hold until its next
        call."""

    def carry(self, mass: float, size: tuple[float, float, float]) -> None:
        """See ``RobotModel``."""
        super().carry(mass, size)
        load_hand(tuple(self.bodies), self.empty, mass, size)

    def evaluate(self, state: RobotState) -> ModelTerms:
        """See ``RobotModel``."""
        planar_terms(*state, tuple(self.bodies), tuple(self.scratch), tuple(self.terms))
        return self.terms

    def zmp_b(self, state: RobotState, acceleration: np.ndarray) -> np.ndarray:
        """See ``RobotModel``."""
        truth = self.truth
        planar_terms(*state, tuple(self.bodies), tuple(self.scratch), tuple(truth))
        return np.array(zero_moment_point(state.q, truth.wrench, acceleration))


def new_scratch() -> Scratch:
    """Memory for one robot."""
    shapes = (8, 3, 3), (8, 3), (10, 6), (8,), (8, 3), (8, 6), (8, 6)
    return Scratch(*(np.zeros(shape) for shape in shapes))


def new_terms() -> ModelTerms:
    """Terms of one robot, in the memory order of Pinocchio's."""
    shapes = (3,), (3, 3), (6,), (6, 10), (6,), (10, 10), (10,), (6, 11)
    terms = ModelTerms(*(np.zeros(shape) for shape in shapes))
    return terms._replace(rotation_w=np.zeros((3, 3), order="F"))


@jit
def planar_terms(
    q: np.ndarray,
    v: np.ndarray,
    bodies: tuple[Any, ...],
    scratch: tuple[Any, ...],
    terms: tuple[Any, ...],
) -> None:
    """Write the terms of the model at one state.

    Args:
        q: Configuration, shape (11,).
        v: Velocity, shape (10,).
        bodies: ``Bodies``.
        scratch: ``Scratch``.
        terms: ``ModelTerms`` with the results.
    """
    bodies_, scratch_, terms_ = Bodies(*bodies), Scratch(*scratch), ModelTerms(*terms)
    _go_out(q, v, bodies_, scratch_, terms_)
    _come_back(scratch_, terms_)


@jit
def zero_moment_point(
    q: np.ndarray, wrench: np.ndarray, acceleration: np.ndarray
) -> tuple[float, float]:
    """Zero-moment point on the ground in the base frame [m].

    Args:
        q: Configuration, shape (11,).
        wrench: Wrench of ``ModelTerms``, shape (6, 11).
        acceleration: Controller's variables u, shape (9,).
    """
    vertical, roll, pitch = wrench[2, 10], wrench[3, 10], wrench[4, 10]
    for j in range(9):
        column = j + (j > 0)
        vertical += wrench[2, column] * acceleration[j]
        roll += wrench[3, column] * acceleration[j]
        pitch += wrench[4, column] * acceleration[j]
    x, y = -pitch / vertical, roll / vertical
    return q[2] * x + q[3] * y, -q[3] * x + q[2] * y


@jit
def _go_out(
    q: np.ndarray, v: np.ndarray, bodies: Bodies, scratch: Scratch, terms: ModelTerms
) -> None:
    """From the base to the hand: axes, velocities, accelerations without v's change."""
    rotation, place, motion = scratch.rotation, scratch.place, scratch.motion
    cos, sin = q[2], q[3]
    rotation[0] = 0.0
    rotation[0, 0, 0], rotation[0, 0, 1] = cos, -sin
    rotation[0, 1, 0], rotation[0, 1, 1], rotation[0, 2, 2] = sin, cos, 1.0
    motion[0, 0], motion[0, 1] = cos, sin
    motion[1, 0], motion[1, 1] = -sin, cos
    motion[2, 5] = 1.0
    turn = (0.0, 0.0, v[2])
    turn_rate = (0.0, 0.0, 0.0)
    velocity = (cos * v[0] - sin * v[1], sin * v[0] + cos * v[1], 0.0)
    x, y, z = cross(turn, velocity)
    rate = (x, y, z + GRAVITY)  # as if the ground went up
    for i in range(BODIES):
        if i > 0:
            parent = rotation[i - 1]
            reach = turned(parent, vector(bodies.place[i]))
            velocity, rate = _carried(velocity, rate, turn, turn_rate, reach)
            place[i, 0] = place[i - 1, 0] + reach[0]
            place[i, 1] = place[i - 1, 1] + reach[1]
            place[i, 2] = place[i - 1, 2] + reach[2]
            _rotate(parent, bodies.rotation[i], q[3 + i], rotation[i])
            axis = (rotation[i, 0, 2], rotation[i, 1, 2], rotation[i, 2, 2])
            lever = cross(vector(place[i]), axis)
            for k in range(3):
                motion[2 + i, k], motion[2 + i, 3 + k] = lever[k], axis[k]
            spin = scaled(v[2 + i], axis)
            turn_rate = added(turn_rate, cross(turn, spin))
            turn = added(turn, spin)
        _weigh(i, bodies, scratch, turn, turn_rate, rate)
    hand = rotation[HAND]
    reach = turned(hand, vector(bodies.grasp_place))
    velocity, rate = _carried(velocity, rate, turn, turn_rate, reach)
    grasp = added(vector(place[HAND]), reach)
    for k in range(3):
        terms.position_w[k] = grasp[k] + (q[k] if k < 2 else 0.0)
        terms.velocity_w[k], terms.velocity_w[3 + k] = velocity[k], turn[k]
        terms.bias_acceleration[k] = rate[k] - (GRAVITY if k == 2 else 0.0)
        terms.bias_acceleration[3 + k] = turn_rate[k]
        row = hand[k, 0], hand[k, 1], hand[k, 2]
        for j in range(3):
            column = bodies.grasp_rotation[:, j]
            terms.rotation_w[k, j] = dot(row, vector(column))
    for j in range(10):
        linear, angular = halves(motion[j])
        linear = added(linear, cross(angular, grasp))
        for k in range(3):
            terms.jacobian[k, j], terms.jacobian[3 + k, j] = linear[k], angular[k]


@jit
def _weigh(
    i: int,
    bodies: Bodies,
    scratch: Scratch,
    turn: Vector,
    turn_rate: Vector,
    rate: Vector,
) -> None:
    """Mass, moment and inertia of one body about O, and the wrench that moves it.

    Args:
        i: Number of the body.
        bodies: Constants.
        scratch: Memory with the result.
        turn: Angular velocity [rad/s].
        turn_rate: Angular acceleration [rad/s^2].
        rate: Acceleration of the body's origin, with gravity [m/s^2].
    """
    mass, rotation = bodies.mass[i], scratch.rotation[i]
    lever = turned(rotation, vector(bodies.com[i]))
    com = added(vector(scratch.place[i]), lever)
    _, rate = _carried(turn, rate, turn, turn_rate, lever)
    force = scaled(mass, rate)
    inertia = _seen(rotation, bodies.inertia[i])
    spin = times(inertia, turn)
    moment = added(times(inertia, turn_rate), cross(turn, spin))
    moment = added(moment, cross(com, force))
    x, y, z = com
    scratch.mass[i] = mass
    for k in range(3):
        scratch.moment[i, k] = mass * com[k]
        scratch.force[i, k], scratch.force[i, 3 + k] = force[k], moment[k]
    about = scratch.inertia[i]
    about[0] = inertia[0] + mass * (y * y + z * z)
    about[1] = inertia[1] - mass * x * y
    about[2] = inertia[2] - mass * x * z
    about[3] = inertia[3] + mass * (x * x + z * z)
    about[4] = inertia[4] - mass * y * z
    about[5] = inertia[5] + mass * (x * x + y * y)


@jit
def _come_back(scratch: Scratch, terms: ModelTerms) -> None:
    """From the hand to the base: masses and forces of composite bodies."""
    motion = scratch.motion
    for i in range(HAND, -1, -1):
        if i < HAND:
            scratch.mass[i] += scratch.mass[i + 1]
            for k in range(3):
                scratch.moment[i, k] += scratch.moment[i + 1, k]
            for k in range(6):
                scratch.inertia[i, k] += scratch.inertia[i + 1, k]
                scratch.force[i, k] += scratch.force[i + 1, k]
        mass, moment = scratch.mass[i], vector(scratch.moment[i])
        about = scratch.inertia[i]
        inertia = about[0], about[1], about[2], about[3], about[4], about[5]
        force, torque = halves(scratch.force[i])
        last = 3 + i
        for j in range(i + 2 if i else 0, last):
            linear, angular = halves(motion[j])
            terms.nonlinear[j] = dot(linear, force) + dot(angular, torque)
            push = added(scaled(mass, linear), cross(angular, moment))
            twist = added(times(inertia, angular), cross(moment, linear))
            for k in range(3):
                terms.wrench[k, j], terms.wrench[3 + k, j] = push[k], twist[k]
            for k in range(last):
                linear, angular = halves(motion[k])
                value = dot(linear, push) + dot(angular, twist)
                terms.mass_matrix[k, j] = terms.mass_matrix[j, k] = value
    for k in range(6):
        terms.wrench[k, 10] = scratch.force[0, k]


@jit
def _carried(
    velocity: Vector, rate: Vector, turn: Vector, turn_rate: Vector, reach: Vector
) -> tuple[Vector, Vector]:
    """Velocity and acceleration at another point of a body.

    Args:
        velocity: Velocity at the first point [m/s].
        rate: Acceleration there [m/s^2].
        turn: Angular velocity [rad/s].
        turn_rate: Angular acceleration [rad/s^2].
        reach: Way from the first point to the other [m].
    """
    sweep = cross(turn, reach)
    rate = added(rate, added(cross(turn_rate, reach), cross(turn, sweep)))
    return added(velocity, sweep), rate


@jit
def _rotate(
    parent: np.ndarray, joint: np.ndarray, angle: float, axes: np.ndarray
) -> None:
    """Write the axes of a link that its joint has turned about z by an angle [rad]."""
    cos, sin = np.cos(angle), np.sin(angle)
    for k in range(3):
        row = parent[k, 0], parent[k, 1], parent[k, 2]
        x = dot(row, vector(joint[:, 0]))
        y = dot(row, vector(joint[:, 1]))
        axes[k, 0], axes[k, 1] = cos * x + sin * y, cos * y - sin * x
        axes[k, 2] = dot(row, vector(joint[:, 2]))


@jit
def _seen(rotation: np.ndarray, inertia: np.ndarray) -> Symmetric:
    """An inertia in the axes of the world."""
    rows = (vector(rotation[0]), vector(rotation[1]), vector(rotation[2]))
    x, y, z = (
        turned(inertia, rows[0]),
        turned(inertia, rows[1]),
        turned(inertia, rows[2]),
    )
    return (
        dot(rows[0], x),
        dot(rows[0], y),
        dot(rows[0], z),
        dot(rows[1], y),
        dot(rows[1], z),
        dot(rows[2], z),
    )
