"""Orders from a task to the controllers, for one step."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from marl_mm.control.records import Reference

if TYPE_CHECKING:  # a task's parameters load without the controller
    from marl_mm.control.records import Priorities
    from marl_mm.robot.model import RobotState

ReferenceAt = Callable[[int, "RobotState"], Reference]
"""Function of a tick's number and the robot's state that returns the reference."""


class Order(NamedTuple):
    """Order to one robot for one step."""

    reference_at: ReferenceAt
    """Reference of the controller's tasks at each tick."""

    priorities: "Priorities"
    """Priorities of the controller's tasks."""
