"""The interface of all policies: joint state in, joint action out."""

from typing import Any, Protocol

import numpy as np

from marl_mm.layout import Layout


class Policy(Protocol):
    """A policy that acts for all agents together."""

    @property
    def name(self) -> str:
        """Name in tables and datasets."""

    def describe(self) -> dict[str, Any]:
        """Settings as JSON values, which results record."""

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Prepare for a new episode.

        Args:
            rng: Only source of the policy's randomness in the episode.
            layout: Layout of the episode's states and actions.

        Raises:
            LayoutError: If the policy is made for another layout.
        """

    def act(self, state: np.ndarray) -> np.ndarray:
        """The joint action, shape (k,), float32, at a joint state, shape (n,)."""
