"""Bodies of the compiled model, and a load in the hand."""

from typing import Any, NamedTuple

import numpy as np

from marl_mm.jit import jit
from marl_mm.robot.vectors import added, dot, scaled, vector

BODIES = 8
"""Number of bodies: the base and the seven links of the arm."""

HAND = BODIES - 1
"""Number of the body with the hand."""


class Bodies(NamedTuple):
    """Constants of the bodies; the hand's change with its load."""

    mass: np.ndarray
    """Masses, shape (8,) [kg]."""

    com: np.ndarray
    """Centres of mass in each body's frame, shape (8, 3) [m]."""

    inertia: np.ndarray
    """Inertias about the centres of mass, shape (8, 3, 3) [kg m^2]."""

    rotation: np.ndarray
    """Rotations of the joints' frames in the previous body's, shape (8, 3, 3)."""

    place: np.ndarray
    """Positions of the joints in the previous body's frame, shape (8, 3) [m]."""

    grasp_rotation: np.ndarray
    """Rotation of the grasp frame in the hand's, shape (3, 3)."""

    grasp_place: np.ndarray
    """Position of the grasp frame in the hand's, shape (3,) [m]."""


@jit
def load_hand(
    bodies: tuple[Any, ...],
    empty: tuple[Any, ...],
    mass: float,
    size: tuple[float, float, float],
) -> None:
    """Count a load at the grasp point as part of the hand.

    Args:
        bodies: ``Bodies``, whose hand is written.
        empty: Mass, centre of mass and inertia of the empty hand.
        mass: Mass of the load [kg]; 0 empties the hand.
        size: Edges of the cuboid whose inertia it has [m].
    """
    bodies_ = Bodies(*bodies)
    empty_mass, empty_com, empty_inertia = empty
    total, turn = empty_mass + mass, bodies_.grasp_rotation
    way = added(vector(bodies_.grasp_place), scaled(-1.0, vector(empty_com)))
    shared, square = empty_mass * mass / total, dot(way, way)
    squares = dot(size, size)
    bodies_.mass[HAND] = total
    for i in range(3):
        bodies_.com[HAND, i] = empty_com[i] + mass / total * way[i]
        for j in range(3):
            value = empty_inertia[i, j] - shared * way[i] * way[j]
            if i == j:
                value += shared * square
            for k in range(3):
                moment = mass / 12 * (squares - size[k] * size[k])
                value += turn[i, k] * moment * turn[j, k]
            bodies_.inertia[HAND, i, j] = value
