"""What one episode is, from the environment to the dataset file and back."""

from dataclasses import dataclass

import numpy as np

from marl_mm.layout import GOAL

INFO = (
    "d_mm",
    "d_mp",
    "distance",
    "is_success",
    "base_jerk_rms",
    "base_acceleration_rms",
    "zmp_margin",
    "tilt",
    "base_pitch",
    "wheel_slip",
    "model_ee_error",
    "qp_failures",
    "safe_ticks",
)
"""Per-step quantities that an episode keeps; see the environment's ``info``."""


@dataclass(frozen=True)
class Episode:
    """One episode of T steps."""

    states: np.ndarray
    """Joint states, the last one after the last action, shape (T + 1, 10)."""

    actions: np.ndarray
    """Joint actions, shape (T, 4), float32."""

    rewards: np.ndarray
    """Shape (T,)."""

    terminated: np.ndarray
    """Goal reached, shape (T,), bool."""

    truncated: np.ndarray
    """Out of steps, shape (T,), bool."""

    info: dict[str, np.ndarray]
    """One array of shape (T,) for each name in ``INFO``."""

    seed: int
    """``env.reset(seed=...)`` and these actions give this episode again, if its goal
    was drawn from the seed (collections) or is given as an option (evaluations)."""

    index: int
    """Number of the attempt in its collection or evaluation."""

    source: str
    """Name of the policy that acted."""

    def __len__(self) -> int:
        return len(self.rewards)

    @property
    def success(self) -> bool:
        """Whether the goal was reached."""
        return bool(self.terminated[-1])

    @property
    def direction(self) -> str:
        """``"forward"`` or ``"backward"``: on which side of the start the goal is."""
        return "forward" if self.states[0, GOAL][0] > 0 else "backward"

    @property
    def episode_return(self) -> float:
        """Undiscounted sum of rewards."""
        return float(self.rewards.sum())
