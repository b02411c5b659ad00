"""What one episode is, from the environment to the dataset file and back."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from marl_mm.errors import UsageError
from marl_mm.layout import Layout

FAILED = "failed"
"""Reward term that every task has: whether the step ended its episode in failure."""

GOAL_INFO = {
    "distance": "what is compared with the goal to the goal at the step's end [m]",
    "is_success": "whether the goal counts as reached at the step's end",
}
"""Step numbers about the goal."""

MOTION_INFO = {
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
"""Step numbers about the robots' motion, looked at every few ticks; of several robots
the worst."""

INFO = {
    "d_mm": "end-effector to its target at the step's end [m]",
    "d_mp": "base to its plan at the step's end [m]",
    **GOAL_INFO,
    **MOTION_INFO,
}
"""Step numbers of tasks in which one hand goes to a goal."""


IMPORTED = "imported"
"""Source of episodes that somebody else collected: not all of ``INFO`` is known."""


def failures(terminated: np.ndarray, is_success: np.ndarray) -> np.ndarray:
    """Steps that ended their episode without success; unknown success counts as one.

    Args:
        terminated: Of steps.
        is_success: As in ``INFO``.
    """
    return np.asarray(terminated & (is_success == 0))


def reward_terms(
    needs: Iterable[str],
    info: Mapping[str, np.ndarray],
    failed: np.ndarray,
    after: np.ndarray,
    layout: Layout,
) -> dict[str, np.ndarray]:
    """What steps' rewards depend on beside the goal, by name, shape (n,) each.

    Args:
        needs: Names of step numbers or of the state's entries; see ``Task.needs``.
        info: Step numbers by name.
        failed: Whether each step ended its episode in failure.
        after: Joint states after the steps, shape (n, d).
        layout: Layout of these.

    Raises:
        UsageError: If neither has one of the names.
    """
    found = {FAILED: failed}
    for name in needs:
        if name in info:
            found[name] = info[name]
        elif name in layout.state_names:
            found[name] = after[:, layout.state_names.index(name)]
        else:
            raise UsageError(
                f"rewards depend on {name!r}, which the episodes do not tell: they "
                f"have {', '.join((*info, *layout.state_names))}"
            )
    return found


def directions(states: np.ndarray, layout: Layout) -> np.ndarray | None:
    """Whether each state's goal is ahead of the robot's start, shape (n,), bool.

    Args:
        states: Joint states, shape (n, d).
        layout: Layout of these; without an entry ``goal_x`` there are no directions.
    """
    if "goal_x" not in layout.desired:
        return None
    return np.asarray(states[:, layout.state_names.index("goal_x")] > 0)


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
    """Step numbers by name, shape (T,) each; see ``Task.info``."""

    layout: Layout
    """Layout of states and actions."""

    seed: int
    """``env.reset(seed=...)`` and these actions give this episode again, if its goal
    was drawn from the seed (collections) or is given as an option (evaluations)."""

    index: int
    """Number of the attempt in its collection or evaluation."""

    source: str
    """Name of the policy that acted."""

    start: np.ndarray
    """Each robot's configuration before the first action, shape (11 R,): base x, y
    [m], cosine and sine of its yaw, joints [rad]."""

    reason: str | None = None
    """Why it failed, or nothing; None in tasks that cannot fail. Not kept in files."""

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
    def direction(self) -> str | None:
        """``"forward"`` or ``"backward"``: on which side of the start the goal is."""
        ahead = directions(self.states[:1], self.layout)
        return None if ahead is None else ("forward" if ahead[0] else "backward")

    @property
    def episode_return(self) -> float:
        """Undiscounted sum of rewards."""
        return float(self.rewards.sum())
