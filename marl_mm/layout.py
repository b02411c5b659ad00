"""Names and order of the joint state and action, and which part each agent has.

Every other package builds on this one place: environments, datasets, algorithms.
"""

from dataclasses import dataclass

STATE = (
    "end_effector_x",
    "end_effector_y",
    "end_effector_z",
    "base_x",
    "base_y",
    "base_yaw",
    "control_mode",
    "goal_x",
    "goal_y",
    "goal_z",
)
"""Joint state, shape (10,): world frame [m], [rad]; control mode is the last alpha."""

ACTION = ("delta_x", "delta_y", "delta_z", "alpha")
"""Joint action, shape (4,): displacement of the end-effector's target, then alpha."""

EE = slice(0, 3)
BASE = slice(3, 6)
MODE = 6
OBSERVATION = slice(0, 7)
GOAL = slice(7, 10)
DELTA = slice(0, 3)
ALPHA = 3

ACTION_LOW = (-1.0, -1.0, -1.0, 0.0)
ACTION_HIGH = (1.0, 1.0, 1.0, 1.0)


def columns(entries: tuple[int, ...]) -> slice | list[int]:
    """Index of these entries; a slice where it says the same, as that makes a view."""
    run = slice(entries[0], entries[-1] + 1)
    return run if entries == tuple(range(run.start, run.stop)) else list(entries)


@dataclass(frozen=True)
class AgentLayout:
    """What one agent sees of the joint state and sets of the joint action."""

    name: str

    observation: tuple[int, ...]
    """Entries of the joint state."""

    action: tuple[int, ...]
    """Entries of the joint action."""


AGENTS = (
    AgentLayout("end_effector", (0, 1, 2, 3, 4, 5, 7, 8, 9), (0, 1, 2)),
    AgentLayout("balance", (0, 1, 2, 3, 4, 5, 6), (3,)),
)
"""In the order of their actions in the joint action."""

JOINT = AgentLayout("joint", tuple(range(len(STATE))), tuple(range(len(ACTION))))
"""One agent that sees and sets everything, for algorithms that know no agents."""
