"""Mean and standard deviation of a stream, without keeping it (Chan 1979)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch


class RunningStatistics:
    """Running mean and standard deviation of vectors, in float64.

    Args:
        width: Number of entries d.
        floor: Least standard deviation.
    """

    def __init__(self, width: int, floor: float) -> None:
        self._floor = floor
        self._count = 0
        self._mean = np.zeros(width)
        self._squares = np.zeros(width)
        """Sum of squared distances to the mean."""

    def add(self, values: np.ndarray) -> None:
        """Add vectors, shape (n, d)."""
        count = len(values)
        mean = values.mean(axis=0)
        total = self._count + count
        shift = mean - self._mean
        self._squares += np.square(values - mean).sum(axis=0)
        self._squares += np.square(shift) * self._count * count / total
        self._mean = self._mean + shift * count / total
        self._count = total

    @property
    def mean(self) -> torch.Tensor:
        """Means, shape (d,), float32."""
        return torch.from_numpy(self._mean.astype(np.float32))

    @property
    def std(self) -> torch.Tensor:
        """Standard deviations or the floor, shape (d,), float32; 1 without data."""
        if not self._count:
            return torch.ones(len(self._mean))
        std = np.sqrt(self._squares / self._count)
        return torch.from_numpy(np.maximum(std, self._floor).astype(np.float32))

    def state(self) -> dict[str, Any]:
        """State for a checkpoint."""
        return {
            "count": self._count,
            "mean": torch.from_numpy(self._mean.copy()),
            "squares": torch.from_numpy(self._squares.copy()),
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a ``state``."""
        self._count = state["count"]
        self._mean = state["mean"].numpy().copy()
        self._squares = state["squares"].numpy().copy()
