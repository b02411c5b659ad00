"""Names and order of the joint state and action, and which part each agent has.

Every other package builds on this one place: environments, datasets, algorithms.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from marl_mm.errors import UsageError

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
GRIP = 3
"""Of ``HANDLING``."""

ALPHA = -1

ACTION_LOW = (-1.0, -1.0, -1.0, 0.0)
ACTION_HIGH = (1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True)
class AgentLayout:
    """What one agent sees of the joint state and sets of the joint action."""

    name: str

    observation: tuple[int, ...]
    """Entries of the joint state."""

    action: tuple[int, ...]
    """Entries of the joint action."""

    low: tuple[float, ...]
    """Least values of these."""

    high: tuple[float, ...]
    """Largest ones."""


@dataclass(frozen=True)
class Layout:
    """Joint state and action of a kind of tasks.

    Whatever it is, the state begins with ``EE``, ``BASE`` and ``MODE`` and ends with
    the goal; the action begins with ``DELTA`` and ends with ``ALPHA``.
    """

    name: str
    state: tuple[str, ...]
    action: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    seen: Mapping[str, tuple[int, ...]]
    """Entries of the state that each agent sees, in the order of their actions."""

    achieved_from: int = 0
    """First of the three entries of the state that are compared with the goal."""

    held: int | None = None
    """Entry that is 1 once a block has been held long enough to count; None: there is
    no block to be taken."""

    @property
    def achieved(self) -> slice:
        """What is compared with the goal."""
        return slice(self.achieved_from, self.achieved_from + 3)

    @property
    def goal(self) -> slice:
        """The state's last three entries."""
        return slice(len(self.state) - 3, len(self.state))

    @property
    def observation(self) -> slice:
        """The state but for the goal."""
        return slice(0, len(self.state) - 3)

    def reward_inputs(self, states: np.ndarray) -> dict[str, np.ndarray]:
        """What of states rewards depend on beside the goal; see ``envs.terms.judge``.

        Args:
            states: After the steps, shape (n, k).
        """
        return {} if self.held is None else {"held": states[:, self.held]}

    @property
    def agents(self) -> tuple[AgentLayout, ...]:
        """``end_effector`` sets all but alpha, ``balance`` alpha."""
        sets = slice(0, len(self.action) - 1), slice(len(self.action) - 1, None)
        entries = tuple(range(len(self.action)))
        return tuple(
            AgentLayout(name, seen, entries[own], self.low[own], self.high[own])
            for (name, seen), own in zip(self.seen.items(), sets, strict=True)
        )

    @property
    def joint(self) -> AgentLayout:
        """One agent that sees and sets everything, for algorithms without agents."""
        seen, sets = tuple(range(len(self.state))), tuple(range(len(self.action)))
        return AgentLayout(JOINT_NAME, seen, sets, self.low, self.high)


JOINT_NAME = "joint"

REACH = Layout(
    "reach",
    STATE,
    ACTION,
    ACTION_LOW,
    ACTION_HIGH,
    {"end_effector": (0, 1, 2, 3, 4, 5, 7, 8, 9), "balance": (0, 1, 2, 3, 4, 5, 6)},
)
"""Of tasks with nothing but a goal."""

HANDLING = Layout(
    "handling",
    (
        *STATE[OBSERVATION],
        "opening",
        "held",
        *("block_x", "block_y", "block_z"),
        *("stand_x", "stand_y", "stand_z"),
        *STATE[GOAL],
    ),
    (*ACTION[:-1], "grip", ACTION[-1]),
    (*ACTION_LOW[:-1], -1.0, ACTION_LOW[-1]),
    (*ACTION_HIGH[:-1], 1.0, ACTION_HIGH[-1]),
    {
        "end_effector": (0, 1, 2, 3, 4, 5, *range(7, 18)),
        "balance": (0, 1, 2, 3, 4, 5, 6, 8),
    },
    achieved_from=9,
    held=8,
)
"""Of tasks with a block to be taken: the end-effector's agent sees it, its stand's top
and the gripper's opening [m], and closes with a ``grip`` above 0; both agents see
whether the block is held."""

LAYOUTS = (REACH, HANDLING)

AGENTS, JOINT = REACH.agents, REACH.joint
"""Of the reach tasks."""


def check_state(state: np.ndarray, layout: Layout) -> None:
    """Raise if a joint state is of tasks with other entries.

    Raises:
        UsageError: Saying what it should be.
    """
    if state.shape != (len(layout.state),):
        raise UsageError(
            f"state has shape {state.shape}, expected ({len(layout.state)},): the "
            f"policy is for tasks that show {', '.join(layout.state)}"
        )


def layout_of(width: int) -> Layout:
    """The layout whose joint states have so many entries.

    Raises:
        UsageError: If there is none.
    """
    return _layout_with("state", width)


def layout_of_actions(width: int) -> Layout:
    """The layout whose joint actions have so many entries.

    Raises:
        UsageError: If there is none.
    """
    return _layout_with("action", width)


def _layout_with(part: Literal["state", "action"], width: int) -> Layout:
    known = {len(getattr(layout, part)): layout for layout in LAYOUTS}
    if width not in known:
        expected = " or ".join(map(str, known))
        raise UsageError(f"{part} has {width} entries, expected {expected}")
    return known[width]


def columns(entries: tuple[int, ...]) -> slice | list[int]:
    """Index of these entries; a slice where it says the same, as that makes a view."""
    run = slice(entries[0], entries[-1] + 1)
    return run if entries == tuple(range(run.start, run.stop)) else list(entries)
