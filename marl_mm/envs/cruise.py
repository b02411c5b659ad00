"""Tasks of one hand: the actions steer the hand, and the base follows slowly."""

import math
from abc import ABC
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np

from marl_mm.control.records import Track
from marl_mm.declared import check_not_negative, check_positive
from marl_mm.envs.intervals import Interval
from marl_mm.envs.order import Order
from marl_mm.envs.task import Attempt, Task, Values
from marl_mm.envs.terms import goal_distance
from marl_mm.errors import LayoutError, UsageError
from marl_mm.layout import Entry
from marl_mm.sim.config import RATE
from marl_mm.sim.scene import Mark, Scene

HAND = tuple(Entry(f"end_effector_{axis}", "m") for axis in "xyz")
"""Position of the end-effector, world frame."""

BASE = (Entry("base_x", "m"), Entry("base_y", "m"), Entry("base_yaw", "rad"))
"""Pose of the base, world frame."""

HAND_X = 0.647
"""Where the hand is along the way in the start posture, world x [m]."""

HAND_Y = 0.1
"""Where the hand is across the robot in the start posture, world y [m]."""

MODE = Entry("control_mode", "1", 0.0, 1.0)
"""Alpha of the last step."""

GOAL = tuple(Entry(f"goal_{axis}", "m") for axis in "xyz")
"""Position of the goal, world frame."""

DELTA = tuple(Entry(f"delta_{axis}", "0.1 m", -1.0, 1.0) for axis in "xyz")
"""Displacement of the end-effector's target from its present position."""

ALPHA = Entry("alpha", "1", 0.0, 1.0)
"""Trade-off of the controller: 0 accurate hand ... 1 stable base."""


def names(*entries: Entry) -> tuple[str, ...]:
    """Names of some entries, in order."""
    return tuple(entry.name for entry in entries)


class BasePlan(NamedTuple):
    """Plan of the base for one step: slow and straight along x."""

    start_x: float
    """Position of the base along x at the step's beginning, world [m]."""

    advance: float
    """Signed length of the plan along x [m]; it lies on y = 0."""

    direction: float
    """Direction of travel: -1 backward, 0 standing, 1 forward."""

    def points(self, ticks: int) -> np.ndarray:
        """Position of the plan after each tick of the step, shape (ticks, 2) [m]."""
        x = self.start_x + self.advance * np.arange(1, ticks + 1) / ticks
        return np.stack([x, np.zeros(ticks)], axis=1)


@dataclass
class Targets:
    """What a task remembers of an episode: targets, plan, draws, failure, numbers."""

    rotation_w: np.ndarray
    """Rotation of the end-effector at the start, which it keeps, shape (3, 3)."""

    alpha: float
    """Control mode of the last step, 0 to 1."""

    target_w: np.ndarray
    """Target of the end-effector in the last step, shape (3,) [m]."""

    plan: BasePlan
    """Plan of the base in the last step."""

    drawn: Any = None
    """What the seed drew beside the goal; None without such things."""

    failure: str = ""
    """Reason of the failure; empty without one."""

    measured: dict[str, float] = field(default_factory=dict)
    """Step numbers of what was drawn, by name."""


@dataclass(frozen=True, kw_only=True)
class CruiseTask(Task, ABC):
    """A task whose base follows the hand's target slowly; its numbers are ours."""

    own_info: ClassVar[dict[str, str]] = {
        "d_mm": "distance of the end-effector to its target at the step's end [m]",
        "d_mp": "distance of the base to its plan at the step's end [m]",
    }

    action_scale: float = 0.1
    """Largest displacement of the end-effector's target per axis and step [m]."""

    initial_alpha: float = 1.0
    """Control mode in the first observation, before any alpha was set."""

    random_start_steps: int = 0
    """Number of random steps before the episode, unseen by the policy."""

    cruise: float = 0.03
    """Largest advance of the base's plan per step [m]. A plan that kept up with the
    hand would make all tasks compatible and alpha meaningless."""

    stand_off: float = HAND_X
    """Distance along x at which the base's plan stays behind the hand's target [m]: the
    end-effector's distance ahead of the base in the initial posture."""

    standing: float = 0.005
    """Advance below which a plan has no direction of travel [m]."""

    heading_gain: float = 1.0
    """Gain of the heading reference, which steers a base back to y = 0 [rad/m]."""

    heading_limit: float = 0.3
    """Largest heading reference [rad]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if type(self).act is CruiseTask.act and hasattr(self, "layout"):
            needed = {*names(*DELTA, ALPHA)} - {*self.layout.action_names}
            if needed:
                raise LayoutError(
                    f"the action of {type(self).__name__} has no "
                    f"{', '.join(sorted(needed))}: its class needs an `act` of its own"
                )
        check_positive(self, "action_scale", "cruise")
        check_not_negative(self, "standing", "heading_limit")
        for name in ("stand_off", "heading_gain"):
            if not math.isfinite(value := getattr(self, name)):
                raise UsageError(f"{name} is {value}, expected a finite number")
        if not 0.0 <= self.initial_alpha <= 1.0:
            raise UsageError(f"initial_alpha is {self.initial_alpha}, expected [0, 1]")
        if self.random_start_steps < 0:
            raise UsageError(
                f"random_start_steps is {self.random_start_steps}, expected >= 0"
            )
        if self.random_start_steps and type(self).at_step is not Task.at_step:
            raise UsageError(
                f"random_start_steps is {self.random_start_steps}, expected 0: "
                f"{type(self).__name__} would not watch what happens in unseen steps"
            )

    def check_way(
        self,
        name: str,
        x: Interval,
        more: float,
        steps: int,
        y: Interval = (0.0, 0.0),
    ) -> None:
        """Raise for places that no hand gets to in time.

        Args:
            name: What is there, such as "goal_".
            x: Interval of their x, world [m].
            more: Way beside that to x [m]; negative where it is enough to be near.
            steps: Number of steps that there are for it.
            y: Interval of their y, world [m].

        Raises:
            UsageError: Naming them, the way, and what a hand goes.
        """
        longest = self.action_scale * steps
        for axis, interval, start, more_to in (
            ("x", x, self.stand_off, more),
            ("y", y, HAND_Y, min(more, 0.0)),
        ):
            way = max(abs(end - start) for end in interval) + more_to
            if way > longest:
                low, high = interval
                raise UsageError(
                    f"{name}{axis} is {low:g} to {high:g} m, a way of {way:.2f} m, "
                    f"expected at most {longest:g} m, as far as a hand goes in {steps} "
                    f"of max_steps, {self.max_steps}"
                )

    # --- Start ---------------------------------------------------------------

    def place(
        self, attempt: Attempt, marks: tuple[Mark, ...], scene: Scene | None = None
    ) -> None:
        """Reset the robot in a new world.

        Args:
            attempt: The episode.
            marks: Marks that are only seen.
            scene: Things to handle.
        """
        (drive,) = attempt.drives
        start = drive.model.evaluate(drive.reset(marks, scene))
        hand_w = self.hand_w(attempt)
        rotation_w = np.ascontiguousarray(start.rotation_w).copy()
        still = BasePlan(0.0, 0.0, 0.0)
        attempt.memory = Targets(rotation_w, self.initial_alpha, hand_w, still)

    def hold(self, attempt: Attempt, target_w: np.ndarray) -> Order:
        """Order to stand and to hold the hand at a position, shape (3,) [m]."""
        attempt.memory.target_w = target_w
        attempt.memory.plan = BasePlan(0.0, 0.0, 0.0)
        return self._order(attempt)

    def wander(self, attempt: Attempt, rng: np.random.Generator) -> None:
        """Take the random steps before the episode."""
        low, high = np.array(self.layout.low), np.array(self.layout.high)
        for _ in range(self.random_start_steps):
            action = rng.uniform(low, high).tolist()
            named = dict(zip(self.layout.action_names, action, strict=True))
            attempt.follow(self.act(attempt, named))

    # --- Step ----------------------------------------------------------------

    @staticmethod
    def hand_w(attempt: Attempt) -> np.ndarray:
        """Present position of the end-effector, world frame, shape (3,) [m]."""
        return attempt.drives[0].world.grasp_position_w()

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        """Move the hand's target, and plan the base towards its place behind it."""
        targets: Targets = attempt.memory
        way = np.array([action[entry.name] for entry in DELTA])
        targets.target_w = self.hand_w(attempt) + self.action_scale * way
        targets.alpha = float(action[ALPHA.name])
        targets.plan = self._plan_base(attempt)
        return [self._order(attempt)]

    def observe(self, attempt: Attempt) -> Values:
        """Hand, base and control mode, by name."""
        targets: Targets = attempt.memory
        state = attempt.drives[0].state
        seen = *self.hand_w(attempt), state.q[0], state.q[1], state.yaw, targets.alpha
        return dict(zip(names(*HAND, *BASE, MODE), seen, strict=True))

    def measure(self, attempt: Attempt) -> dict[str, Any]:
        """Distances of hand and base to their targets [m], and what was measured."""
        targets: Targets = attempt.memory
        base_w = attempt.drives[0].state.q[:2]
        return {
            "d_mm": float(goal_distance(targets.target_w, self.hand_w(attempt))),
            "d_mp": float(goal_distance(targets.plan.points(1)[0], base_w)),
            **targets.measured,
        }

    def _plan_base(self, attempt: Attempt) -> BasePlan:
        """A plan from the measured base towards its place behind the hand's target."""
        base_w = attempt.drives[0].state.q[:2]
        way = attempt.memory.target_w[0] - self.stand_off - base_w[0]
        advance = float(np.clip(way, -self.cruise, self.cruise))
        moves = abs(advance) > self.standing
        return BasePlan(
            float(base_w[0]), advance, float(np.sign(advance)) if moves else 0.0
        )

    def _order(self, attempt: Attempt) -> Order:
        targets: Targets = attempt.memory
        plan, ticks = targets.plan, self.ticks_per_step
        track = Track(
            target_w=targets.target_w,
            rotation_w=targets.rotation_w,
            points=plan.points(ticks),
            heading_gain=self.heading_gain,
            heading_limit=self.heading_limit,
            direction=plan.direction,
            speed=plan.advance * RATE / ticks,
            posture=np.array(self.robot.initial_joints),
        )
        return Order(track, attempt.drives[0].controller.priorities(targets.alpha))
