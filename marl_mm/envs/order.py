"""Orders from a task to the controllers, for one step."""

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from marl_mm.control.records import Reference

if TYPE_CHECKING:  # a task's parameters load without the controller
    from marl_mm.control.records import Priorities
    from marl_mm.robot.model import RobotState


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
        steer = self.heading_gain * state.q[1].item()
        steer = min(max(steer, -self.heading_limit), self.heading_limit)
        return Reference(
            self.target_w,
            self.rotation_w,
            self.points[k],
            -self.direction * steer,
            self.speed,
            self.posture,
        )


class Order(NamedTuple):
    """Order to one robot for one step."""

    reference_at: ReferenceAt
    """Reference of the controller's tasks at each tick."""

    priorities: "Priorities"
    """Priorities of the controller's tasks."""
