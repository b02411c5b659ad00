"""Tasks on whose way to a goal something can go wrong."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from marl_mm.declared import check_positive
from marl_mm.envs.cruise import GOAL, CruiseTask, Targets, names
from marl_mm.envs.intervals import Interval, check_intervals
from marl_mm.envs.load import check_reach
from marl_mm.envs.task import Attempt, ScriptConfig, Task, Terms
from marl_mm.episode import FAILED
from marl_mm.errors import UsageError
from marl_mm.sim.scene import Mark

if TYPE_CHECKING:
    from marl_mm.envs.drive import Motion


@dataclass(frozen=True, kw_only=True)
class RiskyTask(CruiseTask, ABC):
    """Parameters of reward: near the goal an episode ends well, and it can fail."""

    success_distance: float = 0.05
    """Distance to the goal at a step's end below which it is reached, which ends the
    episode [m]."""

    goal_reward: float = 10.0
    """Reward for reaching the goal, instead of minus the distance."""

    failure_reward: float = -30.0
    """Reward of a failure: less than that of any other step. Episodes without one can
    return less: to stand still returns about -39 in QuietZone."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "success_distance", "goal_reward")
        if not self.failure_reward < 0:
            raise UsageError(
                f"failure_reward is {self.failure_reward:g}, expected below 0"
            )

    @property
    def highest_return(self) -> float:
        """Reward of a hit, as all other rewards are negative."""
        return self.goal_reward

    def reached(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Whether the distance is below ``success_distance``."""
        return np.asarray(self.distance(achieved, desired) < self.success_distance)

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Minus the distance [m], or the reward of a hit or of a failure."""
        hit = self.reached(achieved, desired, terms)
        goal = np.where(hit, self.goal_reward, -self.distance(achieved, desired))
        return np.where(terms[FAILED].astype(bool), self.failure_reward, goal)


@dataclass(frozen=True, kw_only=True)
class HazardTask(RiskyTask):
    """Parameters of goals; the seed draws goal and hazards."""

    goal_x: Interval
    """Interval of x of goals, world [m]."""

    goal_y: Interval = (-0.2, 0.2)
    """Interval of y of goals, world [m]."""

    goal_z: Interval = (0.55, 0.8)
    """Interval of z of goals, world [m]."""

    halves: bool = False
    """Whether an episode is half of the way only, drawn: to a goal half way, or from
    there on, after unseen steps of the script."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.halves and type(self).expert is Task.expert:
            raise UsageError(
                f"halves is True, but {type(self).__name__} has no expert to go them"
            )
        check_intervals(self, "goal_x", "goal_y", "goal_z")
        check_reach("goal_", self.goal_y, self.goal_z)
        near = -self.success_distance
        self.check_way("goal_", self.goal_x, near, self.max_steps, self.goal_y)

    # --- The hazard ----------------------------------------------------------

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Any:
        """The hazards of an episode; they do not depend on its goal."""

    @abstractmethod
    def marks(self, hazard: Any) -> Sequence[Mark]:
        """Drawings of the hazards."""

    @abstractmethod
    def harm(self, targets: Targets, motion: "Motion") -> tuple[str, dict[str, float]]:
        """What went wrong in a step, empty if nothing did, and its step numbers.

        Args:
            targets: Targets, and hazards of the episode.
            motion: Motion of the robot in the step.
        """

    # --- The episode ---------------------------------------------------------

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        """Draw goal and hazards, and reset the robot."""
        intervals = self.goal_x, self.goal_y, self.goal_z
        drawn = np.array([rng.uniform(*interval) for interval in intervals])
        hazard = self.draw(rng)
        first = self.halves and rng.random() < 0.5
        half_way = (attempt.drives[0].start_w() + drawn) / 2
        attempt.goal = (half_way if first else drawn) if goal is None else goal
        self.place(attempt, (Mark(tuple(attempt.goal.tolist())), *self.marks(hazard)))
        attempt.memory.drawn = hazard
        if self.halves and not first:
            self._go_half_way(attempt, drawn)

    def _go_half_way(self, attempt: Attempt, goal_w: np.ndarray) -> None:
        """Let the script take the first half of the way to a goal, unseen."""
        goal = dict(zip(names(*GOAL), goal_w.tolist(), strict=True))
        whole = self.distance(self.hand_w(attempt), goal_w)
        for _ in range(self.max_steps):
            if self.distance(self.hand_w(attempt), goal_w) < whole / 2:
                return
            action = self.expert({**self.observe(attempt), **goal}, ScriptConfig())
            self.at_step(attempt, attempt.follow(self.act(attempt, action)))

    def at_step(self, attempt: Attempt, motions: "Sequence[Motion]") -> None:
        """Look for what went wrong; the first failure counts."""
        targets: Targets = attempt.memory
        (motion,) = motions
        reason, targets.measured = self.harm(targets, motion)
        targets.failure = targets.failure or reason

    def failure(self, attempt: Attempt) -> str:
        """What went wrong."""
        reason: str = attempt.memory.failure
        return reason
