"""What a robot is to do during a step: from a task to the controller."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from marl_mm.control.records import Reference

if TYPE_CHECKING:  # a task's numbers are looked at without the controller
    from marl_mm.control.records import Priorities
    from marl_mm.robot.model import RobotState

ReferenceAt = Callable[[int, "RobotState"], Reference]
"""Reference at a tick's number and state."""


class Order(NamedTuple):
    """What one robot is to do during a step."""

    reference_at: ReferenceAt
    """References of the controller's tasks at each tick."""

    priorities: "Priorities"
    """Which of the controller's tasks come first."""
