"""Blocks to carry or to take, drawn for each episode."""

import math
from dataclasses import dataclass
from typing import get_args

import numpy as np

from marl_mm.control.config import HEAVIEST, Knowledge
from marl_mm.declared import check_positive
from marl_mm.envs.intervals import Interval, check_within
from marl_mm.errors import UsageError
from marl_mm.robot.description import BODY_SIZE
from marl_mm.sim.scene import Block, Grasp, Scene

WIDEST = 0.075
"""Largest edge of a block that fits between the open pads, 0.08 apart [m]."""

FAR = 1.3
"""Largest distance of a block along an axis at which the arm reaches it [m]: the arm's
foot is 0.22 ahead of the base, and its reach is 0.855 (Franka data sheet)."""

HIGH = 1.4
"""Largest height of a block in reach [m]: the arm's shoulder is at 0.68."""


@dataclass(frozen=True, kw_only=True)
class LoadConfig:
    """A block that is drawn for each episode; the paper has none."""

    mass: Interval = (0.05, 3.0)
    """Interval of the mass [kg]; the arm carries 3 (Franka data sheet)."""

    edge: Interval = (0.04, 0.06)
    """Interval of the cube's edge [m]."""

    friction: Interval = (0.6, 1.0)
    """Interval of the friction coefficient between block and pads."""

    knowledge: Knowledge = "estimated"
    """Source of the mass for the controller: "estimated" from the joints' torques,
    "given", or "none". The policy never sees the mass."""

    grasp: Grasp = "friction"
    """Kind of grasp: "friction" between the pads, or "weld", fixed to the hand."""

    failure_reward: float = -10.0
    """Reward of a failure, which ends the episode, instead of minus the distance. It
    has to be below the return of standing still until the end, so that failing does not
    pay: lower it for longer episodes."""

    def __post_init__(self) -> None:
        check_positive(self, "mass", "edge", "friction", of="load.")
        if self.edge[1] > WIDEST:
            raise UsageError(f"load.edge is up to {self.edge[1]}, expected <= {WIDEST}")
        if self.knowledge == "estimated" and self.mass[1] > HEAVIEST:
            raise UsageError(
                f"load.mass is up to {self.mass[1]}, expected <= {HEAVIEST:g} where it "
                'is estimated: load.knowledge can be "given"'
            )
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
        """Draw a block."""
        mass, edge, friction = (
            float(rng.uniform(*interval))
            for interval in (self.mass, self.edge, self.friction)
        )
        return Block((edge, edge, edge), mass, friction)


@dataclass(frozen=True, kw_only=True)
class StandConfig(LoadConfig):
    """A block on a stand that is drawn for each episode; the paper has none."""

    stand_x: Interval = (0.60, 0.80)
    """Interval of the stand's x, world [m]; the block is in its middle."""

    stand_y: Interval = (0.42, 0.52)
    """Interval of the stand's y, world [m]: on the arm's side, and out of the base's
    way."""

    stand_height: Interval = (0.42, 0.50)
    """Interval of the stand's height [m]."""

    stand_edge: float = 0.14
    """Edge of the stand's square top [m]."""

    lift: float = 0.0
    """Height of the goal over the block's first position [m]; with 0 the goal is drawn
    as in the reach task."""

    hold_ticks: int = 240
    """Number of ticks clear of its stand after which a block counts as held."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "stand_height", of="load.")
        for name in ("stand_x", "stand_y"):
            low, high = getattr(self, name)
            if not -math.inf < low <= high < math.inf:
                raise UsageError(
                    f"load.{name} is {low} to {high}, expected low <= high"
                )
        half = self.stand_edge / 2
        places = zip((self.stand_x, self.stand_y), BODY_SIZE[:2], strict=True)
        if all(
            low - half < side / 2 and high + half > -side / 2  # some place
            for (low, high), side in places
        ):
            raise UsageError(
                f"load.stand_x is {self.stand_x} and load.stand_y {self.stand_y}, "
                "expected beside the base, which starts at (0, 0) and is "
                f"{BODY_SIZE[0]} by {BODY_SIZE[1]} m"
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

    def check_hold(self, ticks: int) -> None:
        """Raise for a block that is to be held for longer than an episode's ticks.

        Raises:
            UsageError: Naming both.
        """
        if self.hold_ticks > ticks:
            raise UsageError(
                f"load.hold_ticks is {self.hold_ticks}, expected at most an episode's "
                f"{ticks}"
            )

    def draw_scene(self, rng: np.random.Generator) -> Scene:
        """Draw a block on its stand."""
        block = self.draw(rng)
        x, y, height = (
            float(rng.uniform(*interval))
            for interval in (self.stand_x, self.stand_y, self.stand_height)
        )
        stand = self.stand_edge, self.stand_edge, height
        return Scene(block, (x, y, height + block.size[2] / 2), stand, self.grasp)


def in_reach(block_w: tuple[float, float, float], travel: float) -> bool:
    """Whether a hand can take a block there [m] if its base goes ``travel`` [m]."""
    x, y, z = block_w
    return max(abs(x), abs(y)) <= FAR + travel and z <= HIGH


def check_reach(name: str, y: Interval, z: Interval) -> None:
    """Raise for places that no hand reaches whose base drives along x.

    Args:
        name: What is there, such as "goal_".
        y: Interval of their y [m].
        z: Interval of their z [m].

    Raises:
        UsageError: Naming the axis, the interval, and what is in reach.
    """
    check_within(f"{name}y", y, (-FAR, FAR), "what a hand reaches")
    check_within(f"{name}z", z, (0.0, HIGH), "what a hand reaches")
