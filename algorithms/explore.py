"""Exploration: a learned policy with Gaussian noise and, rarely, a random step."""

from typing import Any

import numpy as np

from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.layout import Layout


class Explorer:
    """A policy with noise on its actions.

    Args:
        policy: Policy to explore with.
        noise: Standard deviation of the noise, in halves of each action's range.
        random_share: Share of steps that are uniform in the action space.
    """

    def __init__(
        self, policy: LearnedPolicy, noise: float, random_share: float
    ) -> None:
        self.name = policy.name
        self._policy = policy
        self._noise = noise
        self._random_share = random_share
        self._low, self._high = (
            np.array(policy.layout.low),
            np.array(policy.layout.high),
        )

    def describe(self) -> dict[str, Any]:
        """Noise and the policy's own settings."""
        settings = {"noise": self._noise, "random_share": self._random_share}
        return {**settings, **self._policy.describe()}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Begin an episode with its stream of random numbers."""
        self._rng = rng
        self._policy.begin(rng, layout)

    def act(self, state: np.ndarray) -> np.ndarray:
        """Joint action, shape (k,), float32."""
        low, high = self._low, self._high
        if self._rng.random() < self._random_share:
            return self._rng.uniform(low, high).astype(np.float32)
        noise = self._rng.normal(0.0, self._noise, len(low)) * (high - low) / 2
        action: np.ndarray = np.clip(self._policy.act(state) + noise, low, high)
        return action.astype(np.float32)
