"""MovingReach: follow a goal that moves on a circle.

The hand's agent sees where the goal is and the circle's centre, the balance agent how
fast the goal moves and which way round. The goal is reached after ``seconds`` steps in
a row at whose ends the hand is within ``near_distance`` of it. Nothing fails.

A hand that steers to where the goal is comes too late. Where the goal will be depends
on a rate that only the other agent sees; the hand sees alpha of the last step, by which
the balance agent can tell. The script's alpha is 0.5 for a goal at rest and 0 or 1 for
the fastest, by its way round, and its hand steers to where such a goal is next.
Goals of hindsight ask for the seconds that were reached, often none, and so teach
little.
"""

from dataclasses import dataclass, replace
from math import atan2
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from marl_mm.declared import check_positive
from marl_mm.envs.cruise import (
    ALPHA,
    BASE,
    DELTA,
    GOAL,
    HAND,
    MODE,
    CruiseTask,
    names,
)
from marl_mm.envs.intervals import Interval, check_intervals
from marl_mm.envs.load import check_reach
from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Terms, Values
from marl_mm.envs.tasks.reach import steer
from marl_mm.envs.terms import goal_distance
from marl_mm.errors import UsageError
from marl_mm.layout import Agent, Entry, Layout
from marl_mm.sim.config import Camera
from marl_mm.sim.scene import Mark

if TYPE_CHECKING:
    from collections.abc import Sequence

    from marl_mm.envs.drive import Motion

CENTRE = tuple(Entry(f"circle_{axis}", "m") for axis in "xyz")
"""Centre of the circle, world frame; it lies in the vertical plane across the way."""

GOAL_RATE = Entry("goal_rate", "rad/s")
"""Angular speed of the goal on the circle, positive from y to z."""

SECONDS = Entry("seconds_near", "s", 0.0)
"""Number of last steps in a row at whose ends the hand was near the goal; a step lasts
a second unless ``ticks_per_step`` is another."""

WANTED = Entry("seconds_wanted", "s", 0.0)
"""Number that ends the episode."""

LAYOUT = Layout(
    (*HAND, *BASE, MODE, *GOAL, *CENTRE, GOAL_RATE, SECONDS, WANTED),
    (*DELTA, ALPHA),
    (
        Agent(
            "end_effector",
            names(*HAND, *BASE, MODE, *GOAL, *CENTRE, SECONDS),
            names(*DELTA),
        ),
        Agent("balance", names(*HAND, *BASE, MODE, GOAL_RATE, SECONDS), names(ALPHA)),
    ),
    compared=names(SECONDS),
    desired=names(WANTED),
)
"""Layout of MovingReach: one agent sees where the goal is, the other one how fast it
moves. The first sees what alpha the second set last."""


@dataclass
class Circle:
    """Circle of an episode, and the goal on it."""

    centre_w: np.ndarray
    """Centre of the circle, shape (3,) [m]."""

    angle: float
    """Place of the goal on the circle now [rad]."""

    rate: float
    """Angular speed [rad/s]."""

    near: int = 0
    """Number of last steps in a row at whose ends the hand was near the goal."""


@dataclass(frozen=True, kw_only=True)
class MovingReach(CruiseTask):
    """The task, with circle, goal and reward as fields."""

    about = "Follow a goal that moves on a circle, for three seconds."
    layout = LAYOUT
    hidden: ClassVar[dict[str, float]] = {GOAL_RATE.name: 0.0}
    camera = Camera(target_w=(0.5, 0.0, 0.5), distance=2.1, yaw=40.0, pitch=-20.0)
    needs: ClassVar[tuple[str, ...]] = ("gap",)
    own_info: ClassVar[dict[str, str]] = {
        **CruiseTask.own_info,
        "gap": "distance of the end-effector to the moving goal at the step's end [m]",
    }

    max_steps: int = 20
    """Number of steps until truncation."""

    circle_x: Interval = (0.9, 1.1)
    """Interval of x of the circle's centre, world [m]."""

    circle_y: Interval = (-0.1, 0.1)
    """Interval of y of the circle's centre, world [m]."""

    circle_z: Interval = (0.6, 0.7)
    """Interval of z of the circle's centre, world [m]."""

    radius: float = 0.15
    """Radius of the circle [m]."""

    speed: Interval = (0.05, 0.1)
    """Interval of the goal's speed, either way [m/s]."""

    near_distance: float = 0.025
    """Distance to the goal at a step's end that counts as near [m]."""

    seconds: int = 3
    """Number of steps in a row at whose ends the hand has to be near the goal."""

    goal_reward: float = 10.0
    """Reward for the last of them, instead of minus the distance."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_intervals(self, "circle_x", "circle_y", "circle_z", "speed")
        slow, fast = self.speed
        longest = self.action_scale / self.seconds_per_step
        if not 0.0 < slow <= fast <= longest:
            raise UsageError(
                f"speed is {slow:g} to {fast:g} m/s, expected above 0 and at most "
                f"{longest:g}, which a hand follows"
            )
        if not 1 <= self.seconds <= self.max_steps:
            raise UsageError(
                f"seconds is {self.seconds}, expected 1 to max_steps, {self.max_steps}"
            )
        check_positive(self, "radius", "near_distance", "goal_reward")
        y, z = (
            (low - self.radius, high + self.radius)
            for low, high in (self.circle_y, self.circle_z)
        )
        check_reach("with the radius, circle_", y, z)
        steps = self.max_steps - self.seconds + 1
        near = -self.near_distance
        self.check_way("circle_", self.circle_x, near, steps, self.circle_y)

    @property
    def highest_return(self) -> float:
        """Reward of the end, as all other rewards are negative."""
        return self.goal_reward

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        """Draw circle, place and speed of the goal, and reset the robot."""
        intervals = self.circle_x, self.circle_y, self.circle_z
        centre_w = np.array([rng.uniform(*interval) for interval in intervals])
        angle = rng.uniform(-np.pi, np.pi)
        rate = rng.uniform(*self.speed) / self.radius * rng.choice((-1.0, 1.0))
        attempt.goal = np.array([float(self.seconds)]) if goal is None else goal
        start = Mark(tuple(self._place(centre_w, angle).tolist()), (0.04,))
        self.place(attempt, (start,))
        attempt.memory.drawn = Circle(centre_w, angle, float(rate))

    def at_step(self, attempt: Attempt, motions: "Sequence[Motion]") -> None:
        """Move the goal, and count the seconds near it."""
        circle: Circle = attempt.memory.drawn
        circle.angle += circle.rate * self.seconds_per_step
        goal_w = self._place(circle.centre_w, circle.angle)
        gap = float(goal_distance(self.hand_w(attempt), goal_w))
        circle.near = circle.near + 1 if gap < self.near_distance else 0
        attempt.memory.measured = {"gap": gap}

    def observe(self, attempt: Attempt) -> Values:
        """Joint state of hand and base, the goal, and the seconds near it."""
        circle: Circle = attempt.memory.drawn
        goal_w = self._place(circle.centre_w, circle.angle)
        seen = *goal_w, *circle.centre_w, circle.rate, circle.near
        own = dict(zip(names(*GOAL, *CENTRE, GOAL_RATE, SECONDS), seen, strict=True))
        return {**super().observe(attempt), **own}

    def moved_marks(self, attempt: Attempt) -> list[dict[int, tuple[float, ...]]]:
        """The goal, at the step's end."""
        circle: Circle = attempt.memory.drawn
        return [{0: tuple(self._place(circle.centre_w, circle.angle).tolist())}]

    def _place(self, centre_w: np.ndarray, angle: float) -> np.ndarray:
        aside = self.radius * np.array([0.0, np.cos(angle), np.sin(angle)])
        return np.asarray(centre_w + aside)

    def reached(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Whether the hand was near for as many seconds as wanted."""
        return np.asarray(achieved >= desired)[..., 0]

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Minus the distance to the moving goal [m], or the reward of the end."""
        hit = self.reached(achieved, desired, terms)
        return np.where(hit, self.goal_reward, -np.asarray(terms["gap"]))

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        """Steer to where the goal will be; alpha tells its rate, 0.5 for none."""
        fastest = self.speed[1] / self.radius
        rate = (2 * state[MODE.name] - 1) * fastest
        hand, goal, centre = (
            np.array([state[entry.name] for entry in entries])
            for entries in (HAND, GOAL, CENTRE)
        )
        _, y, z = goal - centre
        angle = atan2(z, y) + rate * self.seconds_per_step
        way = self._place(centre, angle) - hand
        alpha = float(np.clip(0.5 + state[GOAL_RATE.name] / (2 * fastest), 0.0, 1.0))
        return steer(script.kp * way) | {ALPHA.name: alpha}


_MEDIUM = MovingReach()

register_task(
    "MovingReach-easy-v0", replace(_MEDIUM, speed=(0.06, 0.08), near_distance=0.04)
)
register_task("MovingReach-v0", _MEDIUM)
register_task("MovingReach-hard-v0", replace(_MEDIUM, near_distance=0.015))
