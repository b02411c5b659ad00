"""What stands in the world beside the robot; knows nothing of PyBullet."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Block:
    """A cuboid that the gripper can hold."""

    size: tuple[float, float, float] = (0.05, 0.05, 0.05)
    """Edges along x, y and z of the world [m]; the fingers close along x."""

    mass: float = 0.5
    """[kg]"""

    friction: float = 0.8
    """Coefficient against the finger pads, whose own is 1."""


@dataclass(frozen=True)
class Scene:
    """A block between the fingers."""

    block: Block

    position_w: tuple[float, float, float]
    """Of the block's centre [m]."""
