"""A policy with a fixed alpha."""

from typing import Any

import numpy as np

from marl_mm.layout import Layout
from marl_mm.policy import Policy


class FixedAlpha:
    """A policy whose alpha is replaced by a fixed one.

    Where the state has the last alpha, the policy sees the one that it chose itself: a
    joint actor would otherwise move the hand differently, too.

    Args:
        policy: Policy that sets the rest of the action.
        alpha: Fixed alpha, from 0, accurate hand, to 1, stable base.
    """

    def __init__(self, policy: Policy, alpha: float) -> None:
        self._policy, self._alpha = policy, alpha
        self.name = f"{policy.name}, alpha {alpha:g}"
        self._chosen: float | None = None

    def describe(self) -> dict[str, Any]:
        """The alpha, and the policy's own settings."""
        return {**self._policy.describe(), "alpha": self._alpha}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Begin an episode of the policy."""
        self._policy.begin(rng, layout)
        self._mode = layout.columns("control_mode")
        self._place = layout.settings("alpha")
        self._chosen = None

    def act(self, state: np.ndarray) -> np.ndarray:
        """The policy's action with the fixed alpha."""
        seen = state.copy()
        if self._chosen is not None:
            seen[self._mode] = self._chosen
        action = self._policy.act(seen).copy()
        self._chosen = float(action[self._place].item())
        action[self._place] = self._alpha
        return action
