"""What one episode is, from the environment to the dataset file and back."""

from dataclasses import dataclass

import numpy as np

from marl_mm.layout import Layout, layout_of

INFO = {
    "d_mm": "end-effector to its target at the step's end [m]",
    "d_mp": "base to its plan at the step's end [m]",
    "distance": "end-effector, or block to be taken, to the goal at its end [m]",
    "is_success": "whether that is within the task's threshold, and a block held",
    "base_jerk_rms": "of the base's commanded acceleration within the step, without "
    "the jump at its beginning [m/s^3]",
    "base_acceleration_rms": "commanded, over the step [m/s^2]",
    "zmp_margin": "least distance of the zero-moment point to the support's edge [m]",
    "tilt": "largest angle of the base's vertical axis to the world's [rad]",
    "base_pitch": "largest pitch, which the controller's planar model lacks [rad]",
    "wheel_slip": "largest speed of a drive wheel's rim over the ground [m/s]",
    "model_ee_error": "largest distance of the model's hand to the simulator's [m]",
    "qp_failures": "levels of the hierarchy that found no solution",
    "safe_ticks": "ticks in which the limits contradicted each other: it only braked",
}
"""What ``info`` tells of each step, and an episode keeps; looked at every few ticks.

Where there is a block, ``info`` also has ``reason``, why the episode failed or nothing,
and ``held``, whether it counts as held.
"""


IMPORTED = "imported"
"""Source of episodes that somebody else collected: not all of ``INFO`` is known."""


def failures(terminated: np.ndarray, is_success: np.ndarray) -> np.ndarray:
    """Steps that ended their episode without success; unknown success counts as one.

    Args:
        terminated: Of steps.
        is_success: As in ``INFO``.
    """
    return np.asarray(terminated & (is_success == 0))


@dataclass(frozen=True)
class Episode:
    """One episode of T steps."""

    states: np.ndarray
    """Joint states, the last one after the last action, shape (T + 1, n)."""

    actions: np.ndarray
    """Joint actions, shape (T, k), float32."""

    rewards: np.ndarray
    """Shape (T,)."""

    terminated: np.ndarray
    """Goal reached, or failed so that it cannot be, shape (T,), bool."""

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

    start: np.ndarray
    """The robot's configuration before the first action, shape (11,): base x, y [m],
    cosine and sine of its yaw, joints [rad]."""

    reason: str | None = None
    """Why it failed, or nothing; None where there is no block. Not kept in files."""

    def __len__(self) -> int:
        return len(self.rewards)

    @property
    def success(self) -> bool:
        """Whether the goal was reached."""
        return bool(self.terminated[-1] and not self.failed[-1])

    @property
    def failed(self) -> np.ndarray:
        """Steps that ended it otherwise, shape (T,), bool."""
        return failures(self.terminated, self.info["is_success"])

    @property
    def layout(self) -> Layout:
        """Of states and actions."""
        return layout_of(self.states.shape[1])

    @property
    def direction(self) -> str:
        """``"forward"`` or ``"backward"``: on which side of the start the goal is."""
        return "forward" if self.states[0, self.layout.goal][0] > 0 else "backward"

    @property
    def episode_return(self) -> float:
        """Undiscounted sum of rewards."""
        return float(self.rewards.sum())
