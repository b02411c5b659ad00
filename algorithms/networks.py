"""Networks that carry their own input statistics: no checkpoint can lose them."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import nn


class Normalizer(nn.Module):
    """Shifts and scales observations by statistics of the data, kept as buffers.

    Args:
        data: Observations, shape (n, d).
        floor: Least standard deviation: the base hardly moves along y, and what hardly
            varies in the data must not be blown up.
    """

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, data: torch.Tensor, floor: float) -> None:
        super().__init__()
        self.register_buffer("mean", data.mean(dim=0))
        self.register_buffer("std", data.std(dim=0, correction=0).clamp_min(floor))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Shapes (..., d) to (..., d)."""
        return (observation - self.mean) / self.std


class Actor(nn.Module):
    """Deterministic policy of one agent, in normalised action coordinates.

    Args:
        normalizer: Of its observations, shape (..., d).
        actions: Number of action entries k.
        hidden: Units of the hidden layers.
    """

    def __init__(
        self, normalizer: Normalizer, actions: int, hidden: Sequence[int]
    ) -> None:
        super().__init__()
        widths = [normalizer.mean.shape[0], *hidden]
        layers: list[nn.Module] = [normalizer]
        for width, following in pairwise(widths):
            layers += [nn.Linear(width, following), nn.ReLU()]
        layers += [nn.Linear(widths[-1], actions), nn.Tanh()]
        self.layers = nn.Sequential(*layers)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Shapes (..., d) to (..., k), in [-1, 1]."""
        action: torch.Tensor = self.layers(observation)
        return action


class ActionScale:
    """Between an action space and [-1, 1] coordinates.

    Args:
        low: Lowest actions, shape (k,).
        high: Highest actions, shape (k,).
    """

    def __init__(self, low: torch.Tensor, high: torch.Tensor) -> None:
        self._low = low
        self._range = high - low

    def normalize(self, action: torch.Tensor) -> torch.Tensor:
        """From the action space to [-1, 1]."""
        return 2 * (action - self._low) / self._range - 1

    def denormalize(self, action: torch.Tensor) -> torch.Tensor:
        """From [-1, 1] to the action space."""
        return self._low + (action + 1) / 2 * self._range
