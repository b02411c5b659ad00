"""The liquid of Tray's cup: a mass on a damped spring, in compiled code."""

import numpy as np

from marl_mm.jit import jit
from marl_mm.sim.config import RATE


@jit
def swing(path: np.ndarray, motion: np.ndarray, rate: float, damping: float) -> float:
    """Move the liquid along the hand's path; its largest displacement [m].

    Args:
        path: Positions of the hand at ticks, shape (n, 3) [m].
        motion: Displacement and velocity of the liquid, shape (2, 2), which change.
        rate: Natural angular frequency [rad/s].
        damping: Damping ratio.
    """
    peak = 0.0
    for k in range(2, len(path)):
        for axis in range(2):
            push = path[k, axis] - 2 * path[k - 1, axis] + path[k - 2, axis]
            pull = rate * rate * motion[0, axis] + 2 * damping * rate * motion[1, axis]
            motion[1, axis] -= push * RATE + pull / RATE
            motion[0, axis] += motion[1, axis] / RATE
        peak = max(peak, np.hypot(motion[0, 0], motion[0, 1]))
    return peak
