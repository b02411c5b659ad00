"""The random collector: actions drawn uniformly from the action space."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from marl_mm.collectors.registry import COLLECTORS, Collector
from marl_mm.layout import Layout


@dataclass(frozen=True)
class RandomConfig:
    """Settings of the random collector: none."""


class RandomPolicy:
    """Policy of random actions."""

    name = "random"

    def __init__(self, config: RandomConfig) -> None:
        self.config = config

    def describe(self) -> dict[str, Any]:
        """No settings."""
        return {}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Take the episode's stream of random numbers, and its action space."""
        self._rng, self._low, self._high = rng, layout.low, layout.high

    def act(self, state: np.ndarray) -> np.ndarray:
        """An action drawn uniformly from the action space."""
        return self._rng.uniform(self._low, self._high).astype(np.float32)


COLLECTORS.add(
    "random",
    Collector(
        about="Act uniformly at random; keep all episodes.",
        config=RandomConfig,
        policy=lambda config, task: RandomPolicy(config),
    ),
)
