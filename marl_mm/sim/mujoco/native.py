"""Compiled code that advances a world: calls into the engine's own C library.

They need no interpreter, so that a whole step of the environment is one compiled call
without the GIL.
"""

import ctypes
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np
from numba import types
from numba.extending import intrinsic

from marl_mm.errors import MarlMmError, NonFiniteStateError
from marl_mm.jit import jit
from marl_mm.robot.model import RobotState
from marl_mm.sim.config import RATE
from marl_mm.sim.mujoco.engine import mujoco
from marl_mm.sim.planar import planar_state


class Native(NamedTuple):
    """A world in MuJoCo, as its C library and compiled code see it."""

    model: int
    """Address of the ``mjModel``."""

    data: int
    """Address of the ``mjData``."""

    motors: np.ndarray
    """Word of the ``mjData`` that points to the constraints' reference accelerations,
    shape (1,), uint64."""

    qpos: np.ndarray
    """Positions of the joints: place and quaternion w, x, y, z of the base first."""

    qvel: np.ndarray
    """Velocities of the joints: the base's linear one in the world's axes first, then
    its angular one in its own."""

    torque: np.ndarray
    """Torques of the arm joints, shape (7,) [N m]."""

    grasp_w: np.ndarray
    """Position of the end-effector, shape (3,) [m]; old until ``mj_kinematics``."""

    arm: np.ndarray
    """First place of the arm in ``qpos`` and in ``qvel``, shape (2,)."""

    wheels: np.ndarray
    """Places of the left and the right wheel in ``qvel``, shape (2,)."""

    warnings: np.ndarray
    """How often MuJoCo has warned, by kind, shape (7,), int32."""

    rows: np.ndarray
    """Number of constraints before those of the motors, and number of motors: those of
    the wheels, and of the fingers where there is a block, shape (2,)."""

    fingers: np.ndarray
    """Places of the fingers in ``qpos`` and in ``qvel``, shape (2, 2)."""

    grip: np.ndarray
    """Speed [m/s] and largest travel [m] of each finger, shape (2,)."""


def _load() -> None:
    """Let compiled code call MuJoCo, and MuJoCo no clock.

    Its Python package has it read a clock before and after each stage of a step, which
    takes 1 us a step; nothing here reads ``mjData.timer``.
    """
    (library,) = Path(mujoco.__file__).parent.glob("libmujoco.so*")
    llvm.load_library_permanently(str(library))
    ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_time").value = None


_load()
_of_world = types.void(types.uint64, types.uint64)  # model, data
_begin_step = types.ExternalFunction("mj_step1", _of_world)
_end_step = types.ExternalFunction("mj_step2", _of_world)
update_kinematics = types.ExternalFunction("mj_kinematics", _of_world)
"""MuJoCo's ``mj_kinematics``, of the addresses of model and data."""


@intrinsic  # type: ignore[untyped-decorator]
def _write(typing: Any, address: Any, index: Any, value: Any) -> Any:
    """Write a number into an array of C: ``address[index] = value``."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        start, place, number = arguments
        array = builder.inttoptr(start, number.type.as_pointer())
        builder.store(number, builder.gep(array, [place]))
        return context.get_dummy_value()

    return types.void(types.uint64, types.int64, types.float64), generate


@jit
def advance(native: Native, left: float, right: float) -> None:
    """One step of 1/240 s while the wheels turn at these rates [rad/s].

    A wheel's motor is dry friction about a moving reference: a bounded force that gives
    the wheel its rate within the step. Fingers have such motors, too: theirs go on at
    the grip's rate, or to the end of their travel.

    Args:
        native: The world.
        left: Rate of the left wheel [rad/s].
        right: Rate of the right wheel [rad/s].
    """
    _begin_step(native.model, native.data)
    motors, qvel, wheels = native.motors[0], native.qvel, native.wheels
    row, count = native.rows
    _write(motors, row, (left - qvel[wheels[0]]) * RATE)
    _write(motors, row + 1, (right - qvel[wheels[1]]) * RATE)
    for finger in range(count - 2):
        travel = native.qpos[native.fingers[0, finger]]
        rate = min(
            max(native.grip[0], -travel * RATE), (native.grip[1] - travel) * RATE
        )
        rate -= qvel[native.fingers[1, finger]]
        _write(motors, row + 2 + finger, rate * RATE)
    _end_step(native.model, native.data)


@jit
def read(native: Native, q: np.ndarray, v: np.ndarray) -> bool:
    """Write q (11,) and v (10,) of ``RobotState``.

    Returns:
        Whether they are finite, and MuJoCo has not warned.
    """
    for number in native.warnings:
        if number > 0:
            return False
    qpos, qvel = native.qpos, native.qvel
    w, x, y, z = qpos[3], qpos[4], qpos[5], qpos[6]
    a, b, c = qvel[3], qvel[4], qvel[5]
    # The angular velocity in the world's axes: a + 2 w (t x a) + 2 t x (t x a).
    i, j, k = y * c - z * b, z * a - x * c, x * b - y * a
    angular_w = (
        a + 2 * (w * i + y * k - z * j),
        b + 2 * (w * j + z * i - x * k),
        c + 2 * (w * k + x * j - y * i),
    )
    place, rate = native.arm[0], native.arm[1]
    joints, rates = qpos[place : place + 7], qvel[rate : rate + 7]
    return planar_state(
        (qpos[0], qpos[1], qpos[2]),
        (x, y, z, w),
        (qvel[0], qvel[1], qvel[2]),
        angular_w,
        (0.0, 0.0, 0.0),
        joints,
        rates,
        q,
        v,
    )


def fault(native: Native, before: RobotState) -> MarlMmError:
    """Error of a world whose state ``read`` refuses.

    Args:
        native: The world.
        before: State that it came from.
    """
    after = f"after q = {before.q.tolist()}, v = {before.v.tolist()}"
    kinds = [mujoco.mjtWarning(k).name for k in np.flatnonzero(native.warnings)]
    warns = f"MuJoCo warns of {', '.join(kinds)}"
    if kinds and "mjWARN_BAD" not in warns:  # positions, velocities, accelerations
        return MarlMmError(f"{warns} {after}")
    return NonFiniteStateError(
        f"the simulation diverged {after}" + f": {warns}" * bool(kinds)
    )
