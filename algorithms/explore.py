"""Exploration: a learned policy with Gaussian noise and, rarely, a random step."""

from typing import Any

import numpy as np

from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.layout import ACTION_HIGH, ACTION_LOW

_LOW, _HIGH = np.array(ACTION_LOW), np.array(ACTION_HIGH)


class Explorer:
    """Acts as a policy does, disturbed.

    Args:
        policy: Who would act.
        noise: Standard deviation, of half of each action's range.
        random_share: Share of steps that are uniform in the action space; 1 never asks
            the policy.
    """

    def __init__(
        self, policy: LearnedPolicy, noise: float, random_share: float
    ) -> None:
        self.name = policy.name
        self._policy = policy
        self._noise = noise
        self._random_share = random_share

    def describe(self) -> dict[str, Any]:
        """Noise and the policy's own settings."""
        settings = {"noise": self._noise, "random_share": self._random_share}
        return {**settings, **self._policy.describe()}

    def begin(self, rng: np.random.Generator) -> None:
        """Take the episode's stream of random numbers."""
        self._rng = rng
        self._policy.begin(rng)

    def act(self, state: np.ndarray) -> np.ndarray:
        """Joint action, shape (4,), float32."""
        if self._rng.random() < self._random_share:
            return self._rng.uniform(_LOW, _HIGH).astype(np.float32)
        noise = self._rng.normal(0.0, self._noise, len(_LOW)) * (_HIGH - _LOW) / 2
        action: np.ndarray = np.clip(self._policy.act(state) + noise, _LOW, _HIGH)
        return action.astype(np.float32)
