"""Blocks that tasks have to carry or to take: what is drawn for each episode."""

import math
from dataclasses import dataclass
from typing import get_args

import numpy as np

from marl_mm.control.config import Knowledge
from marl_mm.errors import UsageError
from marl_mm.sim.scene import Block, Grasp

Interval = tuple[float, float]

WIDEST = 0.075
"""Edge of a block that open pads, 0.08 apart, can go around [m]."""

FAR = 1.3
"""Farthest along an axis that a base can take a block [m]: the arm's foot is 0.22 ahead
of the base, and it reaches 0.855 (Franka data sheet)."""

HIGH = 1.4
"""Highest that it can [m]: the arm's shoulder is at 0.68."""


@dataclass(frozen=True, kw_only=True)
class LoadConfig:
    """A block, drawn for each episode; all numbers ours."""

    mass: Interval = (0.05, 3.0)
    """Mass [kg]; the arm carries 3 (Franka data sheet)."""

    edge: Interval = (0.04, 0.06)
    """Edge of the cube [m]."""

    friction: Interval = (0.6, 1.0)
    """Coefficient against the pads."""

    knowledge: Knowledge = "estimated"
    """Where the controller has the mass from: "estimated" from the joints' torques,
    "given", or "none". The policy never sees it."""

    grasp: Grasp = "friction"
    """"friction" holds the block between the pads; "weld" fixes it to the hand."""

    failure_reward: float = -10.0
    """Reward of a failure, which ends the episode, instead of minus the distance. In
    the registered tasks it is less than to stand still until the end costs, so that it
    does not pay to fail; with more steps it is to be lowered."""

    def __post_init__(self) -> None:
        _check_positive(self, "mass", "edge", "friction")
        if self.edge[1] > WIDEST:
            raise UsageError(f"load.edge is up to {self.edge[1]}, expected <= {WIDEST}")
        if not self.failure_reward < 0:
            raise UsageError(
                f"load.failure_reward is {self.failure_reward}, expected below 0"
            )
        for name, choices in (("knowledge", Knowledge), ("grasp", Grasp)):
            if getattr(self, name) not in get_args(choices):
                expected = ", ".join(get_args(choices))
                raise UsageError(
                    f"load.{name} is {getattr(self, name)!r}, expected {expected}"
                )

    def draw(self, rng: np.random.Generator) -> Block:
        """A block."""
        mass, edge, friction = (
            float(rng.uniform(*interval))
            for interval in (self.mass, self.edge, self.friction)
        )
        return Block((edge, edge, edge), mass, friction)


@dataclass(frozen=True, kw_only=True)
class StandConfig(LoadConfig):
    """A block on a stand, drawn for each episode; all numbers ours."""

    stand_x: Interval = (0.60, 0.80)
    """Place of the stand, with the block in its middle, world [m]."""

    stand_y: Interval = (0.42, 0.52)
    """Place of the stand, world [m]; on the arm's side, and out of the way of a base
    that passes it."""

    stand_height: Interval = (0.42, 0.50)
    """Height of the stand [m]."""

    stand_edge: float = 0.14
    """Edge of its square top [m]."""

    lift: float = 0.0
    """Height of the goal over where the block is at first [m]; 0: the goal is one of
    the reach task's."""

    hold_ticks: int = 240
    """Ticks that a block has to be held, clear of its stand, to count as held."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_positive(self, "stand_height")
        for name in ("stand_x", "stand_y"):
            low, high = getattr(self, name)
            if not -math.inf < low <= high < math.inf:
                raise UsageError(
                    f"load.{name} is {low} to {high}, expected low <= high"
                )
        if not self.stand_edge >= self.edge[1]:
            raise UsageError(
                f"load.stand_edge is {self.stand_edge}, expected >= load.edge, "
                f"{self.edge[1]}"
            )
        if self.hold_ticks < 0 or not 0 <= self.lift <= 0.5:
            raise UsageError(
                f"load.hold_ticks is {self.hold_ticks} and load.lift {self.lift}, "
                "expected >= 0, and lift <= 0.5"
            )


def in_reach(block_w: tuple[float, float, float], travel: float) -> bool:
    """Whether a block can be taken by a hand whose base goes ``travel`` metres."""
    x, y, z = block_w
    return max(abs(x), abs(y)) <= FAR + travel and z <= HIGH


def _check_positive(load: LoadConfig, *names: str) -> None:
    """Raise for the first field that is no interval above 0.

    Raises:
        UsageError: Naming it.
    """
    for name in names:
        low, high = getattr(load, name)
        if not 0 < low <= high < math.inf:
            raise UsageError(
                f"load.{name} is {low} to {high}, expected 0 < low <= high"
            )
