"""A step of a robot as one compiled call: model, controller and engine, tick by tick.

``marl_mm.envs.drive`` has the same loop in Python, which is its reference.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from marl_mm.control.compiled.along import reference_on
from marl_mm.control.compiled.tick import tick
from marl_mm.control.limits import WHEEL_ARM
from marl_mm.control.payload import learned
from marl_mm.control.records import VARIABLES, Track, checked
from marl_mm.control.wbc import no_command_error
from marl_mm.envs.drive import Drive, Motion
from marl_mm.envs.order import Order
from marl_mm.jit import jit, on_stack
from marl_mm.robot.bodies import load_hand
from marl_mm.robot.description import WHEEL_RADIUS
from marl_mm.robot.model import RobotState
from marl_mm.robot.planar import PlanarModel, planar_terms, zero_moment_point
from marl_mm.robot.support import SUPPORT_B, SUPPORT_INWARD_B
from marl_mm.sim.config import RATE
from marl_mm.sim.mujoco.native import Native, advance, fault, read, update_kinematics
from marl_mm.sim.planar import attitude, rim_rates

DONE, NO_COMMAND, NO_STATE = range(3)
"""How ticks end: the last one by a command that is not finite, or by the state after
it, which is not finite or which the engine warns of."""

_configuration, _velocity = on_stack(11), on_stack(10)
_acceleration = on_stack(VARIABLES)
_counters = on_stack(4, number=types.int64)
_attitude, _rim_rates = jit(attitude), jit(rim_rates)


def can_follow(drive: Drive, order: Order) -> bool:
    """Whether a robot's step can be one compiled call."""
    solver = drive.controller.config.solver
    return solver == "active-set" and isinstance(order.reference_at, Track)


def follow(drive: Drive, order: Order, ticks: int, every: int) -> Motion:
    """Run a robot's controller for some ticks; ``drive.state`` is the robot after them.

    Args:
        drive: The robot, in a world with ``native``.
        order: Its order, whose reference is a ``Track``.
        ticks: Number of ticks of 1/240 s.
        every: Number of ticks between measurements of stability.

    Raises:
        NonFiniteStateError: If the controller finds no finite command, or the
            simulation diverges.
        MarlMmError: If MuJoCo warns of anything else.
        UsageError: If an array of the order has another shape.
    """
    model, controller, native = drive.model, drive.controller, drive.world.native
    assert native and isinstance(model, PlanarModel)
    assert isinstance(order.reference_at, Track)
    track, priorities = checked(order.reference_at, order.priorities)
    accelerations, looks = np.empty(ticks), np.empty((-(-ticks // every), 5))
    path, hand_w = np.empty((ticks, 11)), np.empty((ticks, 3))
    q, v, counts = drive.state.q.copy(), drive.state.v.copy(), np.zeros(2, np.int64)
    hand, first = drive.hand, 0
    load = Load(np.zeros(3), (0.0, 0.0, 0.0), model.empty, model.truth)
    while first < ticks:
        last = ticks
        if hand is not None:
            last = min(ticks, first + hand.ticks_to_look)
            payload = hand.payload
            load.masses[:] = payload.mass, payload.true_mass, payload.learns
            load = load._replace(size=payload.size)
        outcome = _follow(
            native,
            model.bodies,
            model.scratch,
            model.terms,
            load,
            track,
            controller.numbers,
            *priorities,
            controller.rows,
            first,
            last,
            every,
            accelerations,
            path,
            hand_w,
            looks,
            q,
            v,
            counts,
        )
        if outcome == NO_COMMAND:
            raise no_command_error(RobotState(q, v), track.target_w, priorities)
        if outcome == NO_STATE:
            raise fault(native, RobotState(q, v))
        if hand is not None:
            if payload.learns:
                payload.count(load.masses[0].item())
            hand.wait(last - first, model.terms.position_w)
        first = last
    drive.state = drive.world.read()
    margins, tilts, pitches, slips, errors = looks.T.tolist()
    return Motion(
        accelerations,
        path,
        hand_w,
        min(margins),
        max(tilts),
        max(pitches, key=abs),
        max(slips),
        max(errors),
        *counts.tolist(),
    )


class Load(NamedTuple):
    """A load in the hand."""

    masses: np.ndarray
    """Mass in the model and true one [kg], and 1 where the first is estimated, shape
    (3,)."""

    size: tuple[float, float, float]
    """Edges of the cuboid [m]."""

    empty: tuple[Any, ...]
    """Mass, centre of mass and inertia of the empty hand."""

    truth: Any
    """Memory for ``ModelTerms`` with the true mass."""


@jit
def _follow(
    native: Native,
    bodies: Any,
    scratch: Any,
    terms: Any,
    load: Load,
    track: Track,
    numbers: tuple[Any, ...],
    matrices: np.ndarray,
    shares: np.ndarray,
    rows: int,
    first: int,
    last: int,
    every: int,
    accelerations: np.ndarray,
    path: np.ndarray,
    hand_w: np.ndarray,
    looks: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    counts: np.ndarray,
) -> int:
    """All ticks, or those until one fails, whose first state q and v then are.

    Arguments are those of ``follow``, with results in the last seven.

    Returns:
        ``DONE``, ``NO_COMMAND`` or ``NO_STATE``.
    """
    robot, gains, hierarchy, limits = numbers
    u, torque, counters = _acceleration(), native.torque, _counters()
    q_before, v_before = _configuration(), _velocity()
    for k in range(first, last):
        planar_terms(q, v, bodies, scratch, terms)
        counters[:] = 0
        feasible, finite, forward, turning = tick(
            (q, v),
            terms,
            reference_on(track, k, q),
            robot,
            gains,
            hierarchy,
            limits,
            matrices,
            shares,
            rows,
            float(RATE),
            u,
            torque,
            counters,
        )
        if not finite:
            return NO_COMMAND
        if k % every == 0:
            wrench = terms[7]
            if load.masses[1] != load.masses[0]:
                load_hand(bodies, load.empty, load.masses[1], load.size)
                planar_terms(q, v, bodies, scratch, load.truth)
                load_hand(bodies, load.empty, load.masses[0], load.size)
                wrench = load.truth[7]
            _look(native, terms, wrench, q, v, u, looks[k // every])
        accelerations[k] = u[0]
        _copy(q, path[k])
        _copy(terms[0], hand_w[k])
        if counters[2] > 0:
            counts[0] += counters[2]
            counts[1] += not feasible
        _copy(q, q_before)
        _copy(v, v_before)
        left, right = _rim_rates(forward, turning)
        advance(native, left, right)
        if not read(native, q, v):
            _copy(q_before, q)
            _copy(v_before, v)
            return NO_STATE
        if load.masses[2]:
            mass = learned(load.masses[0], float(RATE), v_before, terms, torque, v)
            load.masses[0] = mass
            load_hand(bodies, load.empty, mass, load.size)
    return DONE


@jit
def _copy(numbers: np.ndarray, to: Any) -> None:
    """Copy numbers, as an assignment would allocate memory."""
    for i in range(len(numbers)):
        to[i] = numbers[i]


@jit
def _look(
    native: Native,
    terms: Any,
    wrench: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    to: Any,
) -> None:
    """Write what ``Drive.look`` measures, shape (5,)."""
    x, y = zero_moment_point(q, wrench, u)
    margin = np.inf
    for e in range(SUPPORT_B.shape[0]):
        ahead = (x - SUPPORT_B[e, 0]) * SUPPORT_INWARD_B[e, 0]
        aside = (y - SUPPORT_B[e, 1]) * SUPPORT_INWARD_B[e, 1]
        margin = min(margin, ahead + aside)
    qpos, qvel, wheels = native.qpos, native.qvel, native.wheels
    roll, pitch = _attitude((qpos[4], qpos[5], qpos[6], qpos[3]))
    turn = WHEEL_ARM * v[2]
    left = abs(WHEEL_RADIUS * qvel[wheels[0]] - v[0] + turn)
    right = abs(WHEEL_RADIUS * qvel[wheels[1]] - v[0] - turn)
    update_kinematics(native.model, native.data)
    error = 0.0
    for i in range(3):
        error += (terms[0][i] - native.grasp_w[i]) ** 2
    to[0], to[1], to[2] = margin, np.hypot(roll, pitch), pitch
    to[3], to[4] = max(left, right), np.sqrt(error)
