"""One controller tick on a track, compiled, for a loop in Python.

Numba takes 40 ns to take over an array, and 100 ns for a tuple before what is in it.
Numbers that stay the same for many ticks therefore come in few arrays.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numba import types
from numba.np.unsafe.ndarray import to_fixed_tuple

from marl_mm.control.compiled.tick import tick
from marl_mm.control.config import Gains, HierarchyConfig, LimitConfig
from marl_mm.control.limits import ROWS, ZMP_ROWS
from marl_mm.control.records import Track, reference_along
from marl_mm.jit import jit, on_stack

_GAINS, _HIERARCHY, _LIMITS = (
    len(record._fields) for record in (Gains, HierarchyConfig, LimitConfig)
)

_counters = on_stack(4, number=types.int64)

reference_on = jit(reference_along)
"""``reference_along`` for compiled code."""


def packed(values: Iterable[Any]) -> np.ndarray:
    """Numbers and arrays one after the other, shape (n,), float64."""
    return np.concatenate([np.ravel(value) for value in values], dtype=np.float64)


@jit
def tick_along(
    q: np.ndarray,
    v: np.ndarray,
    position_w: np.ndarray,
    rotation_w: np.ndarray,
    velocity_w: np.ndarray,
    jacobian: np.ndarray,
    bias_acceleration: np.ndarray,
    mass_matrix: np.ndarray,
    nonlinear: np.ndarray,
    wrench: np.ndarray,
    k: int,
    numbers: np.ndarray,
    line: np.ndarray,
    points: np.ndarray,
    matrices: np.ndarray,
    shares: np.ndarray,
    u: np.ndarray,
    torque: np.ndarray,
) -> tuple[bool, tuple[tuple[float, float], int, int, int, int, bool]]:
    """One controller tick with the reference of a track.

    Args:
        q: See ``RobotState``.
        v: See ``RobotState``.
        position_w: See ``ModelTerms``.
        rotation_w: See ``ModelTerms``.
        velocity_w: See ``ModelTerms``.
        jacobian: See ``ModelTerms``.
        bias_acceleration: See ``ModelTerms``.
        mass_matrix: See ``ModelTerms``.
        nonlinear: See ``ModelTerms``.
        wrench: See ``ModelTerms``.
        k: Number of the tick.
        numbers: ``RobotLimits``, ``Gains``, ``HierarchyConfig``, ``LimitConfig`` and
            the ticks per second, packed.
        line: The ``Track`` without its points, packed.
        points: Points of the track.
        matrices: See ``Priorities``.
        shares: See ``Priorities``.
        u: Resulting acceleration, shape (9,).
        torque: Resulting torques of the arm joints, shape (7,) [N m].

    Returns:
        Whether u is finite, and the fields of ``Command`` after the torque.
    """
    speed, acceleration, others = numbers[:9], numbers[9:18], numbers[40:]
    lower, upper, most = numbers[18:25], numbers[25:32], numbers[32:39]
    gains = to_fixed_tuple(others[:_GAINS], _GAINS)
    others = others[_GAINS:]
    hierarchy = to_fixed_tuple(others[:_HIERARCHY], _HIERARCHY)
    others = others[_HIERARCHY:]
    limits = to_fixed_tuple(others[:_LIMITS], _LIMITS)
    track = Track(
        line[:3],
        line[3:12].reshape(3, 3),
        points,
        line[12],
        line[13],
        line[14],
        line[15],
        line[16:],
    )
    counters = _counters()
    counters[:] = 0
    feasible, finite, forward, turning = tick(
        (q, v),
        (
            position_w,
            rotation_w,
            velocity_w,
            jacobian,
            bias_acceleration,
            mass_matrix,
            nonlinear,
            wrench,
        ),
        reference_on(track, k, q),
        (speed, acceleration, lower, upper, most, numbers[39]),
        gains,
        (*hierarchy[:-1], int(hierarchy[-1])),  # the iterations
        limits,
        matrices,
        shares,
        ZMP_ROWS.stop if LimitConfig(*limits).zmp else ROWS,
        others[_LIMITS],
        u,
        torque,
        counters,
    )
    levels, qps, failures, cause = to_fixed_tuple(counters, 4)
    speeds = forward, turning
    return finite, (speeds, levels, qps, failures, cause, not feasible)
