"""Terms of rewards as pure functions, vectorised over leading axes."""

import numpy as np


def goal_distance(achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
    """Distance of what was achieved and the goal, shapes (..., g) to (...) [m].

    Summed along the axis: without it, numpy asks BLAS, whose last bit depends on the
    processor.
    """
    distance: np.ndarray = np.linalg.norm(np.subtract(achieved, desired), axis=-1)
    return distance
