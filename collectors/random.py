"""The random collector: actions drawn uniformly from the action space."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from marl_mm.layout import layout_of


@dataclass(frozen=True)
class RandomConfig:
    """Nothing to set."""

    @property
    def name(self) -> str:
        """Of the collector."""
        return "random"


class RandomPolicy:
    """Acts without looking."""

    name = "random"

    def __init__(self, config: RandomConfig) -> None:
        self.config = config

    def describe(self) -> dict[str, Any]:
        """The config."""
        return {}

    def begin(self, rng: np.random.Generator) -> None:
        """Take the episode's stream of random numbers."""
        self._rng = rng

    def act(self, state: np.ndarray) -> np.ndarray:
        """Uniform in the action space."""
        layout = layout_of(len(state))
        return self._rng.uniform(layout.low, layout.high).astype(np.float32)
