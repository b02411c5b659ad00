"""Inputs and output of the controller: reference, priorities and command."""

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from marl_mm.control.limits import LIMIT_NAMES
from marl_mm.errors import UsageError

if TYPE_CHECKING:  # a task's parameters load without the model
    from marl_mm.robot.model import RobotState

VARIABLES = 9
"""Number of variables u: base forward [m/s^2], base yaw [rad/s^2], seven arm joints
[rad/s^2]."""


class Reference(NamedTuple):
    """Targets of the tasks at one tick."""

    ee_position_w: np.ndarray
    """Target of the end-effector, shape (3,) [m]."""

    ee_rotation_w: np.ndarray
    """Target axes of the end-effector as columns, shape (3, 3)."""

    base_position_w: np.ndarray
    """Position of the base plan, shape (2,) [m]."""

    base_heading: float
    """Heading to keep [rad]."""

    base_speed: float
    """Speed of the base plan along the heading [m/s]."""

    posture: np.ndarray
    """Posture that the arm returns to, shape (7,) [rad]."""


class ReferenceAt(Protocol):
    """Function of a tick's number and the robot's state."""

    def __call__(self, k: int, state: "RobotState", /) -> Reference:
        """Reference of the controller's tasks."""


class Track(NamedTuple):
    """Reference of a hand that holds a target while the base follows a straight line.

    It is a ``ReferenceAt`` in numbers, which compiled code reads, too.
    """

    target_w: np.ndarray
    """Target of the end-effector, shape (3,) [m]."""

    rotation_w: np.ndarray
    """Target axes of the end-effector as columns, shape (3, 3)."""

    points: np.ndarray
    """Position of the base's plan after each tick, shape (ticks, 2) [m]."""

    heading_gain: float
    """Gain of the heading that steers a base back to y = 0 [rad/m]."""

    heading_limit: float
    """Largest heading [rad]."""

    direction: float
    """Direction of travel: -1 backward, 0 standing, 1 forward."""

    speed: float
    """Speed of the base's plan along the heading [m/s]."""

    posture: np.ndarray
    """Posture that the arm returns to, shape (7,) [rad]."""

    def __call__(self, k: int, state: "RobotState") -> Reference:
        """Reference at a tick."""
        return reference_along(self, k, state.q)


def reference_along(track: Track, k: int, q: np.ndarray) -> Reference:
    """Reference of a track at tick k and configuration q, shape (11,).

    Raises:
        UsageError: If the track has no point for the tick.
    """
    if k >= len(track.points):  # compiled code would read what lies behind them
        raise UsageError("a track has fewer points than its step has ticks")
    steer = track.heading_gain * float(q[1])
    steer = min(max(steer, -track.heading_limit), track.heading_limit)
    return Reference(
        track.target_w,
        track.rotation_w,
        track.points[k],
        -track.direction * steer,
        track.speed,
        track.posture,
    )


class Priorities(NamedTuple):
    """Priorities of the tasks: one hierarchy, or a mix of several."""

    matrices: np.ndarray
    """Cumulative priority matrices, shape (m, 4, 5)."""

    shares: np.ndarray
    """Weight of each hierarchy's solution in u, shape (m,)."""


def checked(track: Track, priorities: Priorities) -> tuple[Track, Priorities]:
    """Both in arrays of their own, which compiled code reads without a look at them.

    Raises:
        UsageError: If an array has another shape.
    """
    ticks, hierarchies = len(track.points), len(priorities.shares)
    shapes = {
        "target_w": (3,),
        "rotation_w": (3, 3),
        "points": (ticks, 2),
        "posture": (7,),
        "matrices": (hierarchies, 4, 5),
        "shares": (hierarchies,),
    }
    values = {**track._asdict(), **priorities._asdict()}
    for name, expected in shapes.items():
        if (shape := np.shape(values[name])) != expected:
            raise UsageError(
                f"an order's {name} has shape {shape}, expected {expected}"
            )
        values[name] = np.array(values[name], np.float64, order="C")
    for name in values.keys() - shapes.keys():
        values[name] = float(values[name])
    *line, matrices, shares = values.values()
    return Track(*line), Priorities(matrices, shares)


class Command(NamedTuple):
    """Command to the robot until the next tick."""

    acceleration: np.ndarray
    """Acceleration u, shape (9,)."""

    torque: np.ndarray
    """Torques of the arm joints, clipped to their limits, shape (7,) [N m]."""

    base_speed: tuple[float, float]
    """Base speeds for the wheels: forward [m/s], yaw rate [rad/s]. The measured speeds
    plus u over a tick: an integral of u alone would go on while the wheels slip, and
    jerk the base when they grip again."""

    levels: int
    """Number of levels solved."""

    qps: int
    """Number of levels that needed a QP, as the closed form broke a limit."""

    failures: int
    """Number of levels whose QP failed, and which were skipped."""

    cause: int
    """Row of the limits behind the last failure, see ``reason``."""

    safe: bool
    """Whether no acceleration met all limits, so that the command only brakes."""

    @property
    def reason(self) -> str | None:
        """Limit behind the last failed level, in words.

        Of a command that only brakes, the limit that braking breaks most.
        """
        if self.failures == 0:
            return None
        if self.cause < 0:
            return "the QP ran out of iterations"
        return f"{LIMIT_NAMES[self.cause]}: out of reach within the other limits"
