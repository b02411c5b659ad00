"""The support polygon: where the base's wheels and casters touch the ground."""

import numpy as np

from marl_mm.robot.description import CASTER_X, CASTER_Y, WHEEL_SEPARATION

SUPPORT_B = np.array(
    [
        (CASTER_X[0], CASTER_Y),
        (0.0, WHEEL_SEPARATION / 2),
        (CASTER_X[1], CASTER_Y),
        (CASTER_X[1], -CASTER_Y),
        (0.0, -WHEEL_SEPARATION / 2),
        (CASTER_X[0], -CASTER_Y),
    ]
)
"""Corners of the support polygon in the base frame, counter-clockwise, (6, 2) [m]."""

_EDGE = np.roll(SUPPORT_B, -1, axis=0) - SUPPORT_B
_NORMAL = np.stack([-_EDGE[:, 1], _EDGE[:, 0]], axis=1)
SUPPORT_INWARD_B = _NORMAL / np.linalg.norm(_NORMAL, axis=1, keepdims=True)
"""Inward normals of the edges from each corner to the next, shape (6, 2)."""

_OFFSET_B = (SUPPORT_B * SUPPORT_INWARD_B).sum(axis=1)


def support_margin(point_b: np.ndarray) -> float:
    """Distance of a ground point to the support polygon's edge, inside positive [m]."""
    margin: float = min((SUPPORT_INWARD_B @ point_b - _OFFSET_B).tolist())
    return margin
