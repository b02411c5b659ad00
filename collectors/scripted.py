"""The scripted collector: over the block, down, close, up, to the goal.

It remembers nothing: what it does follows from the joint state alone, so that it can be
learnt from the data. Without a block that is to be taken it steers to the goal.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from marl_mm.errors import UsageError
from marl_mm.layout import ALPHA, DELTA, EE, GRIP, HANDLING, layout_of

CLOSED = 0.0775
"""Narrower openings hold something [m]: blocks have up to 0.075, the open hand 0.08."""

HOLDS = 0.025
"""A block this near to the grasp point is between the closed fingers [m]."""

THERE = 0.012
"""A block this near is between the open fingers [m]."""

OVER = 0.008
"""Most the hand is off the block along the ground before it goes down [m]."""

CLEARANCE = 0.09
"""Of the grasp point over the block while it comes [m]: the pads end 1 cm below it."""

LIFT = 0.12
"""Of the block's centre over its stand before it is carried away [m]."""


@dataclass(frozen=True)
class ScriptedConfig:
    """What the script leaves open."""

    alpha: float = 0.0
    """Held at this: 0 accurate hand ... 1 stable base."""

    kp: float = 10.0
    """Action per distance [1/m]; 10 asks for the place itself within 0.1 m."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.alpha <= 1.0:
            raise UsageError(f"alpha is {self.alpha}, expected a number in [0, 1]")
        if not (np.isfinite(self.kp) and self.kp > 0):
            raise UsageError(f"kp is {self.kp}, expected > 0")

    @property
    def name(self) -> str:
        """Of the collector."""
        return "scripted"


class ScriptedPolicy:
    """Takes the block and brings it to the goal."""

    name = "scripted"

    def __init__(self, config: ScriptedConfig) -> None:
        self.config = config

    def describe(self) -> dict[str, Any]:
        """The config."""
        return asdict(self.config)

    def begin(self, rng: np.random.Generator) -> None:
        """Nothing to remember between episodes."""

    def act(self, state: np.ndarray) -> np.ndarray:
        """A function of the joint state."""
        layout = layout_of(len(state))
        action = np.zeros(len(layout.action), np.float32)
        if layout is HANDLING:
            way, action[GRIP] = _handle(state)
        else:
            way = state[layout.goal] - state[EE]
        action[DELTA] = np.clip(self.config.kp * way, -1.0, 1.0)
        action[ALPHA] = self.config.alpha
        return action


def _handle(state: np.ndarray) -> tuple[np.ndarray, float]:
    """Where the hand goes from here [m], and whether it closes."""
    block = state[HANDLING.achieved]
    to_block, to_goal = block - state[EE], state[HANDLING.goal] - block
    near = np.linalg.norm(to_block)
    if state[HANDLING.state.index("opening")] < CLOSED and near < HOLDS:
        up = state[HANDLING.state.index("stand_z")] + LIFT - block[2]
        if up > 0.02 and np.linalg.norm(to_goal[:2]) > 0.06:
            return np.array([0.0, 0.0, up]), 1.0
        return to_goal, 1.0
    if near < THERE:
        return np.zeros(3), 1.0
    if np.linalg.norm(to_block[:2]) > OVER:
        return to_block + np.array([0.0, 0.0, CLEARANCE]), -1.0
    return to_block, -1.0
