"""A script that takes a block: over it, down, close, up, to the goal.

It has no memory: its action follows from the joint state alone, so that a policy can
learn it from data.
"""

import numpy as np

from marl_mm.envs.terms import length

CLOSED = 0.0775
"""Opening below which the hand holds something [m]: blocks are up to 0.075 wide."""

HOLDS = 0.025
"""Distance to the grasp point at which the closed fingers hold a block [m]."""

THERE = 0.012
"""Distance to the grasp point at which a block is between the open fingers [m]."""

OVER = 0.008
"""Largest horizontal distance to the block at which the hand goes down [m]."""

CLEARANCE = 0.09
"""Height of the grasp point over the block on the approach [m]: the pads end 1 cm
below the grasp point."""

LIFT = 0.12
"""Height of the block's centre over its stand at which it is carried away [m]."""


def grasping(
    hand: np.ndarray,
    block: np.ndarray,
    stand: np.ndarray,
    goal: np.ndarray,
    opening: float,
) -> tuple[np.ndarray, bool]:
    """The next displacement of the hand, shape (3,) [m], and whether it closes.

    Args:
        hand: Grasp point, shape (3,) [m].
        block: Centre of the block, shape (3,) [m].
        stand: Middle of the stand's top, shape (3,) [m].
        goal: Goal of the block, shape (3,) [m].
        opening: Distance between the finger tips [m].
    """
    to_block, to_goal = block - hand, goal - block
    near = length(to_block)
    if opening < CLOSED and near < HOLDS:
        up = stand[2] + LIFT - block[2]
        if up > 0.02 and length(to_goal[:2]) > 0.06:
            return np.array([0.0, 0.0, up]), True
        return to_goal, True
    if near < THERE:
        return np.zeros(3), True
    if length(to_block[:2]) > OVER:
        return to_block + np.array([0.0, 0.0, CLEARANCE]), False
    return to_block, False
