"""What every policy is, scripted or learned: joint state in, joint action out."""

from typing import Any, Protocol

import numpy as np

from marl_mm.layout import Layout


class Policy(Protocol):
    """A policy for all agents together."""

    @property
    def name(self) -> str:
        """How tables and datasets call it."""

    def describe(self) -> dict[str, Any]:
        """Its settings, JSON-serialisable, so that a result says whose it is."""

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """A new episode starts.

        Args:
            rng: Only source of randomness in it.
            layout: Layout of its states and actions.

        Raises:
            LayoutError: If the policy is for another one.
        """

    def act(self, state: np.ndarray) -> np.ndarray:
        """Joint action, shape (k,), float32, at a joint state, shape (n,)."""
