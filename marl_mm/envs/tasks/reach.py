"""Reach: bring the end-effector to a goal ahead of the robot or behind it."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from marl_mm.declared import check_not_negative, check_positive
from marl_mm.envs.cruise import ALPHA, BASE, DELTA, GOAL, HAND, MODE, CruiseTask, names
from marl_mm.envs.intervals import Interval, check_intervals
from marl_mm.envs.load import check_reach
from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Terms, Values
from marl_mm.layout import Agent, Layout
from marl_mm.sim.scene import Mark

LAYOUT = Layout(
    (*HAND, *BASE, MODE, *GOAL),
    (*DELTA, ALPHA),
    (
        Agent("end_effector", names(*HAND, *BASE, *GOAL), names(*DELTA)),
        Agent("balance", names(*HAND, *BASE, MODE), names(ALPHA)),
    ),
    compared=names(*HAND),
    desired=names(*GOAL),
)
"""Layout of Reach. The balance agent does not see the goal, and the end-effector's
agent does not see the control mode."""


@dataclass(frozen=True, kw_only=True)
class Reach(CruiseTask):
    """The task, with goals and reward as fields."""

    about = "Bring the end-effector to a goal ahead or behind."
    layout = LAYOUT
    needs: ClassVar[tuple[str, ...]] = ("d_mm", "d_mp", "base_jerk_rms")

    goal_x_forward: Interval = (1.0, 1.5)
    """Interval of x of goals ahead, world [m] (paper, Sec. 5.1)."""

    goal_x_backward: Interval = (-0.8, -0.5)
    """Interval of x of goals behind, equally likely, world [m] (paper, Sec. 5.1)."""

    goal_y: Interval = (-0.2, 0.2)
    """Interval of y of goals, world [m] (paper, Sec. 5.1)."""

    goal_z: Interval = (0.55, 0.8)
    """Interval of z of goals, world [m] (paper, Sec. 5.1)."""

    success_distance: float = 0.05
    """Distance to the goal at a step's end below which it is reached, which ends the
    episode [m]."""

    goal_reward: float = 10.0
    """Reward for reaching the goal, instead of minus the distance (Eq. 6)."""

    ee_error_weight: float = 5.0
    """Weight of d_mm in the reward [1/m] (Eq. 7)."""

    base_error_weight: float = 5.0
    """Weight of d_mp in the reward [1/m] (Eq. 8)."""

    jerk_weight: float = 0.0
    """Weight of the base's rms jerk in the reward [s^3/m], see ``MOTION_INFO``; 0 gives
    the paper's reward."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "success_distance", "goal_reward")
        weights = "ee_error_weight", "base_error_weight", "jerk_weight"
        check_not_negative(self, *weights)
        check_intervals(self, "goal_x_forward", "goal_x_backward", "goal_y", "goal_z")
        check_reach("goal_", self.goal_y, self.goal_z)

    @property
    def highest_return(self) -> float:
        """Reward of a perfect hit, as all other rewards are negative."""
        return self.goal_reward

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        """Draw a goal, reset the robot, and take the random steps."""
        drawn = np.array(self._draw_goal(rng, ahead=bool(rng.random() < 0.5)))
        attempt.goal = drawn if goal is None else goal
        self.place(attempt, (Mark(tuple(attempt.goal.tolist())),))
        self.wander(attempt, rng)

    def fixed_goal(
        self, index: int, rng: np.random.Generator
    ) -> tuple[float, ...] | None:
        """Goals that alternate between ahead and behind."""
        return self._draw_goal(rng, ahead=not index % 2)

    def reached(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Whether the distance is below ``success_distance``."""
        return np.asarray(self.distance(achieved, desired) < self.success_distance)

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Reward of the paper, Eq. 6-9, minus the cost of jerk."""
        hit = self.reached(achieved, desired, terms)
        goal = np.where(hit, self.goal_reward, -self.distance(achieved, desired))
        return self.charged(goal, terms)

    def charged(self, goal: np.ndarray, terms: Terms) -> np.ndarray:
        """A goal's reward minus the costs of hand, base and jerk."""
        hand = self.ee_error_weight * terms["d_mm"]
        base = self.base_error_weight * terms["d_mp"]
        jerk = self.jerk_weight * terms["base_jerk_rms"]
        return np.asarray(goal - hand - base - jerk)

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        """Steer straight to the goal."""
        return steer(script.kp * to_goal(state)) | {ALPHA.name: script.alpha}

    def _draw_goal(
        self, rng: np.random.Generator, ahead: bool
    ) -> tuple[float, float, float]:
        x = self.goal_x_forward if ahead else self.goal_x_backward
        gx, gy, gz = (float(rng.uniform(*a)) for a in (x, self.goal_y, self.goal_z))
        return gx, gy, gz


def to_goal(state: Values) -> np.ndarray:
    """Way of the hand to the goal, shape (3,) [m]."""
    pairs = zip(GOAL, HAND, strict=True)
    return np.array([state[goal.name] - state[hand.name] for goal, hand in pairs])


def steer(way: np.ndarray) -> dict[str, float]:
    """Displacements by name along a vector, shape (3,), clipped to the bounds."""
    return dict(zip(names(*DELTA), np.clip(way, -1.0, 1.0).tolist(), strict=True))


register_task("Reach-v0", Reach())
register_task("SmoothReach-v0", Reach(jerk_weight=0.2))
register_task("PreciseReach-v0", Reach(success_distance=0.02, random_start_steps=8))
