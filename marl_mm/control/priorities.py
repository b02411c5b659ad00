"""Priorities: the paper's two tables and the mixes of them.

Cumulative coding: a task of strict level L has psi = 0 above row L and 1 from it down,
so that interpolated columns never decrease. Table 1, Eq. 4 of the paper. Columns: base
velocity, base orientation, manipulator position, manipulator orientation, arm posture.
"""

import numpy as np

STABILITY_LEVELS = (1, 1, 2, 3, 4)
"""Psi1, better move stability: alpha = 1 (Table 1)."""

REACHING_LEVELS = (3, 3, 1, 2, 4)
"""Psi2, better reaching: alpha = 0 (Table 1)."""

LEVELS = 4

LEFT_OUT = LEVELS + 1
"""Level of a task that has no part in the hierarchy."""

HANDLED = 1e-5
"""Rise of psi above which a level handles a task."""


def cumulative(levels: tuple[int, ...]) -> np.ndarray:
    """Priority matrix of strict levels, shape (4, 5); see ``LEFT_OUT``."""
    rows = np.arange(1, LEVELS + 1)[:, None]
    return (rows >= np.array(levels)[None, :]).astype(float)


STABILITY = cumulative(STABILITY_LEVELS)
REACHING = cumulative(REACHING_LEVELS)


def stability_share(alpha: float, response: float) -> float:
    """Share of stability at alpha: 0 at 0, 1 at 1, rising early where response > 1.

    The hand is held back by base tasks of weight s against (1 - s) of its own, so that
    it gives way as 1 / (1 - s): almost nothing happens before s is near 1. With s =
    1 - (1 - alpha)^response the response spreads over alpha's range.
    """
    share: float = 1.0 - (1.0 - alpha) ** response
    return share


def priority_matrix(share: float) -> np.ndarray:
    """Psi = s Psi1 + (1 - s) Psi2 (Eq. 4, with s for alpha), shape (4, 5)."""
    return share * STABILITY + (1 - share) * REACHING
