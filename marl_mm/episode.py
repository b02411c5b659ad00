"""One episode, from the environment to the dataset's file and back."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from marl_mm.errors import UsageError
from marl_mm.layout import Layout

FAILED = "failed"
"""Name of the reward term of every task: whether the step failed the episode."""

GOAL_INFO = {
    "distance": "distance of the compared entries to the goal at the step's end, in "
    "their unit",
    "is_success": "whether the goal counts as reached at the step's end",
}
"""Meanings, with units, of the step numbers about the goal, by name."""

MOTION_INFO = {
    "base_jerk_rms": "rms jerk of the base's commanded acceleration within the step, "
    "without the jump at its beginning [m/s^3]",
    "base_acceleration_rms": "rms acceleration of the base, commanded [m/s^2]",
    "zmp_margin": "least distance of the zero-moment point to the support's edge [m]",
    "tilt": "largest angle of the base's vertical axis to the world's [rad]",
    "base_pitch": "largest pitch, which the controller's planar model lacks [rad]",
    "wheel_slip": "largest speed of a drive wheel's rim over the ground [m/s]",
    "model_ee_error": "largest distance of the model's hand to the simulator's [m]",
    "qp_failures": "levels of the hierarchy that found no solution",
    "safe_ticks": "ticks in which the limits contradicted each other: it only braked",
}
"""Meanings, with units, of the step numbers about the robots' motion, by name. Jerk,
acceleration and the counts are of every tick, the others of every few. Of several
robots the worst counts, and the sum of counts."""

INFO = {
    "d_mm": "distance of the end-effector to its target at the step's end [m]",
    "d_mp": "distance of the base to its plan at the step's end [m]",
    **GOAL_INFO,
    **MOTION_INFO,
}
"""Meanings, with units, of the step numbers of tasks in which one hand reaches."""


IMPORTED = "imported"
"""Source of episodes from files of others, which may lack some of ``INFO``."""


def failures(terminated: np.ndarray, is_success: np.ndarray) -> np.ndarray:
    """Steps that ended their episode without success; unknown success counts as one.

    Args:
        terminated: Whether each step ended its episode, shape (n,).
        is_success: Whether each step reached the goal, shape (n,), as in ``INFO``.
    """
    return np.asarray(terminated & (is_success == 0))


def reward_terms(
    needs: Iterable[str],
    info: Mapping[str, np.ndarray],
    failed: np.ndarray,
    after: np.ndarray,
    layout: Layout,
) -> dict[str, np.ndarray]:
    """Numbers that steps' rewards depend on beside the goal, by name, shape (n,) each.

    Args:
        needs: Names of step numbers or of the state's entries; see ``Task.needs``.
        info: Step numbers by name, shape (n,) each.
        failed: Whether each step ended its episode in failure, shape (n,).
        after: Joint states after the steps, shape (n, d).
        layout: Layout of the states.

    Raises:
        UsageError: If a name is neither a step number's nor a state entry's.
    """
    terms = {FAILED: failed}
    for name in needs:
        if name in info:
            terms[name] = info[name]
        elif name in layout.state_names:
            terms[name] = after[:, layout.state_names.index(name)]
        else:
            raise UsageError(
                f"rewards depend on {name!r}, which the episodes lack: they "
                f"have {', '.join((*info, *layout.state_names))}"
            )
    return terms


def directions(states: np.ndarray, layout: Layout) -> np.ndarray | None:
    """Whether each state's goal is ahead of the robot's start, shape (n,), bool.

    Args:
        states: Joint states, shape (n, d).
        layout: Layout of the states. Without an entry ``goal_x`` the result is None.
    """
    if "goal_x" not in layout.desired:
        return None
    return np.asarray(states[:, layout.state_names.index("goal_x")] > 0)


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T steps."""

    states: np.ndarray
    """Joint states, the last one after the last action, shape (T + 1, n)."""

    actions: np.ndarray
    """Joint actions, shape (T, k), float32."""

    rewards: np.ndarray
    """Rewards of the steps, shape (T,)."""

    terminated: np.ndarray
    """Whether a step reached the goal or failed, shape (T,), bool."""

    truncated: np.ndarray
    """Whether the episode ran out of steps, shape (T,), bool."""

    info: dict[str, np.ndarray]
    """Step numbers by name, shape (T,) each; see ``Task.info``."""

    layout: Layout
    """Layout of states and actions."""

    seed: int
    """Seed of the environment. ``env.reset(seed=...)`` and the actions repeat the
    episode if its goal was drawn from the seed, or is given as an option."""

    index: int
    """Number of the attempt in its collection or evaluation."""

    source: str
    """Name of the policy that acted."""

    start: np.ndarray
    """Each robot's configuration before the first action, shape (11 R,): base x, y
    [m], cosine and sine of its yaw, joints [rad]."""

    reason: str | None = None
    """Reason of the failure, empty without one; None in tasks that cannot fail. Files
    do not keep it."""

    def __len__(self) -> int:
        return len(self.rewards)

    @property
    def success(self) -> bool:
        """Whether the goal was reached."""
        return bool(self.terminated[-1] and not self.failed[-1])

    @property
    def failed(self) -> np.ndarray:
        """Whether a step ended the episode without success, shape (T,), bool."""
        return failures(self.terminated, self.info["is_success"])

    @property
    def direction(self) -> str | None:
        """Side of the start on which the goal is: "forward" or "backward"."""
        ahead = directions(self.states[:1], self.layout)
        return None if ahead is None else ("forward" if ahead[0] else "backward")

    @property
    def episode_return(self) -> float:
        """Undiscounted sum of rewards."""
        return float(self.rewards.sum())
