"""Carry: reach with a block of unseen mass in the hand."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from marl_mm.envs.load import LoadConfig
from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, Terms
from marl_mm.envs.tasks.reach import Reach
from marl_mm.episode import FAILED
from marl_mm.sim.scene import Mark, Scene

GOAL_SIZE = 0.02
"""Radius of the goal's ball where a block must not be hidden by it [m]."""


@dataclass(frozen=True, kw_only=True)
class Carry(Reach):
    """The task, with goals, reward and load as fields."""

    about = "Bring a load of unknown mass in the hand to a goal ahead or behind."
    handles: ClassVar[bool] = True

    load: LoadConfig = field(default_factory=lambda: LoadConfig(failure_reward=-50.0))
    """Intervals of the block in the hand."""

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        """Draw goal and block, and hold the block still for one step."""
        drawn = np.array(self._draw_goal(rng, ahead=bool(rng.random() < 0.5)))
        block = self.load.draw(rng)
        attempt.goal = drawn if goal is None else goal
        (drive,) = attempt.drives
        start_w = drive.start_w()
        x, y, z = start_w.tolist()
        scene = Scene(block, (x, y, z), grasp=self.load.grasp)
        goal_mark = Mark(tuple(attempt.goal.tolist()), (GOAL_SIZE,))
        self.place(attempt, (goal_mark,), scene)
        drive.handle(scene, self.load.knowledge).take(self.hand_w(attempt))
        attempt.follow([self.hold(attempt, start_w)])
        self.wander(attempt, rng)

    def failure(self, attempt: Attempt) -> str:
        """Loss of the block, or a collision."""
        hand = attempt.drives[0].hand
        return "" if hand is None else hand.failure

    def measure(self, attempt: Attempt) -> dict[str, Any]:
        """Distances of hand and base [m], and whether the block is held."""
        return {**super().measure(attempt), "held": self.holds(attempt)}

    def holds(self, attempt: Attempt) -> bool:
        """Whether the block is held."""
        hand = attempt.drives[0].hand
        return hand is not None and hand.held

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Reward of Reach, with the load's reward for a failure."""
        hit = self.reached(achieved, desired, terms)
        goal = np.where(hit, self.goal_reward, -self.distance(achieved, desired))
        failed = terms[FAILED].astype(bool)
        return self.charged(np.where(failed, self.load.failure_reward, goal), terms)


register_task("CarryReach-v0", Carry())
