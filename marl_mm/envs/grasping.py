"""A script that takes a block: over it, down, close, up, to the goal.

It remembers nothing: what it does follows from the joint state alone, so that it can be
learnt from the data.
"""

import numpy as np

CLOSED = 0.0775
"""Narrower openings hold something [m]: blocks have up to 0.075, the open hand 0.08."""

HOLDS = 0.025
"""A block this near to the grasp point is between the closed fingers [m]."""

THERE = 0.012
"""A block this near is between the open fingers [m]."""

OVER = 0.008
"""Most the hand is off the block along the ground before it goes down [m]."""

CLEARANCE = 0.09
"""Height of the grasp point over the block while it comes [m]: the pads end 1 cm below
it."""

LIFT = 0.12
"""Height of the block's centre over its stand before it is carried away [m]."""


def grasping(
    hand: np.ndarray,
    block: np.ndarray,
    stand: np.ndarray,
    goal: np.ndarray,
    opening: float,
) -> tuple[np.ndarray, bool]:
    """Where the hand goes from here [m], and whether it closes.

    Args:
        hand: Grasp point, shape (3,) [m].
        block: Centre of the block, shape (3,) [m].
        stand: Middle of its stand's top, shape (3,) [m].
        goal: Where the block is to go, shape (3,) [m].
        opening: Between the finger tips [m].
    """
    to_block, to_goal = block - hand, goal - block
    near = np.linalg.norm(to_block)
    if opening < CLOSED and near < HOLDS:
        up = stand[2] + LIFT - block[2]
        if up > 0.02 and np.linalg.norm(to_goal[:2]) > 0.06:
            return np.array([0.0, 0.0, up]), True
        return to_goal, True
    if near < THERE:
        return np.zeros(3), True
    if np.linalg.norm(to_block[:2]) > OVER:
        return to_block + np.array([0.0, 0.0, CLEARANCE]), False
    return to_block, False
