"""The scene beside the robot: block, stand, marks; independent of the engine."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from marl_mm.declared import (
    check_not_negative,
    check_positive,
    like,
    make_like_defaults,
)
from marl_mm.errors import UsageError

ORIGIN = (0.0, 0.0, 0.0)
"""Origin of the world [m]."""


@dataclass(frozen=True)
class Block:
    """A cuboid that the gripper can hold."""

    size: tuple[float, float, float] = (0.05, 0.05, 0.05)
    """Edges along x, y and z of the world [m]; the fingers close along x."""

    mass: float = 0.5
    """Mass [kg]."""

    friction: float = 0.8
    """Friction coefficient against the stand and the finger pads, whose own is 1."""

    def __post_init__(self) -> None:
        make_like_defaults(self, "block ")
        check_positive(self, "mass", of="block ")
        check_not_negative(self, "friction", of="block ")
        if min(self.size) <= 0:
            raise UsageError(f"block size is {self.size}, expected edges above 0")


Color = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""

RED: Color = (0.90, 0.25, 0.15, 1.0)
"""Colour of goals."""

YELLOW: Color = (0.95, 0.80, 0.15, 0.6)
"""Colour of hazards."""

AMBER: Color = (0.80, 0.45, 0.05, 1.0)
"""Colour of parts of hazards that would not be seen in front of the others."""

GREY: Color = (0.35, 0.35, 0.4, 1.0)
"""Colour of things that are carried."""


@dataclass(frozen=True)
class Mark:
    """A drawing in the world without a body: a goal, a zone."""

    position_w: tuple[float, ...]
    """Centre, x, y and z [m]."""

    size: tuple[float, ...] = (0.03,)
    """Radius of a ball, or edges of a box along x, y and z [m]."""

    color: Color = RED
    """Colour."""

    def __post_init__(self) -> None:
        many = (0.0,) * (3 if np.shape(self.size) == (3,) else 1)
        for name, usual in {"position_w": ORIGIN, "size": many, "color": RED}.items():
            value = like(getattr(self, name), usual, f"a mark's {name}")
            object.__setattr__(self, name, value)
        if min(self.size) < 0:
            raise UsageError(f"a mark's size is {self.size}, expected >= 0")


Grasp = Literal["friction", "weld"]
"""Way of holding a block: between the pads, or fixed to the hand, which is faster."""


@dataclass(frozen=True)
class Scene:
    """A block, on a stand or in the hand."""

    block: Block
    """The block."""

    position_w: tuple[float, float, float]
    """Position of the block's centre [m]."""

    stand_size: tuple[float, float, float] | None = None
    """Edges of the stand [m], which reaches from the ground to the block. None: no
    stand, the block is in the hand."""

    grasp: Grasp = "friction"
    """Way of holding the block."""

    def __post_init__(self) -> None:
        if self.grasp not in get_args(Grasp):
            raise UsageError(f"grasp is {self.grasp!r}, expected friction or weld")
        if not isinstance(self.block, Block):
            raise UsageError(f"block is {self.block!r:.60}, expected a Block")
        like(self.position_w, ORIGIN, "a block's position_w")
        if self.stand_size is not None:
            like(self.stand_size, ORIGIN, "stand_size")

    @property
    def stand_w(self) -> tuple[float, float, float]:
        """Centre of the stand's top [m]; without a stand, the point on the ground."""
        x, y, _ = self.position_w
        return x, y, 0.0 if self.stand_size is None else self.stand_size[2]
