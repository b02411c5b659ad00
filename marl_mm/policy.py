"""What every policy is, scripted or learned: joint state in, joint action out."""

from typing import Any, Protocol

import numpy as np


class Policy(Protocol):
    """A policy for both agents together."""

    @property
    def name(self) -> str:
        """How tables and datasets call it."""

    def describe(self) -> dict[str, Any]:
        """Its settings, JSON-serialisable, so that a result says whose it is."""

    def begin(self, rng: np.random.Generator) -> None:
        """A new episode starts; ``rng`` is the only source of randomness in it."""

    def act(self, state: np.ndarray) -> np.ndarray:
        """Joint action, float32, at a joint state, as in the task's ``Layout``."""
