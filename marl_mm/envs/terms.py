"""Terms of reward functions as pure functions, vectorised over leading axes."""

import numpy as np


def goal_distance(achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
    """Distances of achieved entries to goals, shapes (..., g) to (...) [m].

    With an axis numpy sums by itself. Without one it calls BLAS, whose last bit depends
    on the processor.
    """
    distance: np.ndarray = np.linalg.norm(np.subtract(achieved, desired), axis=-1)
    return distance
