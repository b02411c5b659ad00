"""A task of the controller: A u = b, linear in the variables u."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Task:
    """A task at one state: its target acceleration, A u = b."""

    name: str
    """Name in words."""

    jacobian: np.ndarray
    """Jacobian A, shape (rows, 9)."""

    target: np.ndarray
    """Target b, shape (rows,): feedback acceleration minus the bias Jdot v."""
