"""Vectors and symmetric matrices as tuples, for compiled code: nothing is allocated."""

import numpy as np

from marl_mm.jit import jit

Vector = tuple[float, float, float]

Symmetric = tuple[float, float, float, float, float, float]
"""A symmetric matrix: xx, xy, xz, yy, yz, zz."""


@jit
def turned(rotation: np.ndarray, a: Vector) -> Vector:
    """A vector in the axes that a rotation, shape (3, 3), turns it to."""
    return (
        rotation[0, 0] * a[0] + rotation[0, 1] * a[1] + rotation[0, 2] * a[2],
        rotation[1, 0] * a[0] + rotation[1, 1] * a[1] + rotation[1, 2] * a[2],
        rotation[2, 0] * a[0] + rotation[2, 1] * a[1] + rotation[2, 2] * a[2],
    )


@jit
def times(a: Symmetric, b: Vector) -> Vector:
    """A symmetric matrix times a vector."""
    return (
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
        a[1] * b[0] + a[3] * b[1] + a[4] * b[2],
        a[2] * b[0] + a[4] * b[1] + a[5] * b[2],
    )


@jit
def vector(a: np.ndarray) -> Vector:
    """The first three numbers of an array."""
    return a[0], a[1], a[2]


@jit
def halves(a: np.ndarray) -> tuple[Vector, Vector]:
    """Linear and angular part of an array of six numbers."""
    return (a[0], a[1], a[2]), (a[3], a[4], a[5])


@jit
def added(a: Vector, b: Vector) -> Vector:
    """The sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@jit
def scaled(a: float, b: Vector) -> Vector:
    """A number times a vector."""
    return a * b[0], a * b[1], a * b[2]


@jit
def dot(a: Vector, b: Vector) -> float:
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit
def cross(a: Vector, b: Vector) -> Vector:
    """The vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
