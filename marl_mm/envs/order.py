"""Orders from a task to the controllers, for one step."""

from typing import NamedTuple

from marl_mm.control.records import Priorities, ReferenceAt


class Order(NamedTuple):
    """Order to one robot for one step."""

    reference_at: ReferenceAt
    """Reference of the controller's tasks at each tick."""

    priorities: Priorities
    """Priorities of the controller's tasks."""
