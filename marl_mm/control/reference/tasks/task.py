"""What every task is: A u = b, linear in the controller's variables u."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Task:
    """One task at one state: the acceleration it wants, A u = b."""

    name: str

    jacobian: np.ndarray
    """A, shape (rows, 9)."""

    target: np.ndarray
    """b, shape (rows,): feedback acceleration minus the bias Jdot v."""
