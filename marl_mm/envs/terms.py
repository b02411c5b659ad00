"""Terms of reward functions as pure functions, vectorised over leading axes."""

import numpy as np


def length(vectors: np.ndarray) -> np.ndarray:
    """Euclidean lengths of vectors, shapes (..., n) to (...), the same everywhere.

    With an axis numpy sums by itself. Without one it calls BLAS, whose last bit depends
    on the processor.
    """
    lengths: np.ndarray = np.linalg.norm(vectors, axis=-1)
    return lengths


def goal_distance(achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
    """Distances of achieved entries to goals, shapes (..., g) to (...) [m]."""
    return length(np.subtract(achieved, desired))
