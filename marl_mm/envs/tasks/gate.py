"""Gate: bring the end-effector through a window in a thick wall to a goal beyond.

The hand's agent sees window and goal, the balance agent only how far the wall is from
the hand. As long as that is more than ``quiet_until``, the floor is quiet: an episode
fails if the base is told to accelerate by more than ``quiet_limit``. Within the wall it
fails if the finger tips are further than ``wall.clearance`` from the middle of the
window, which goes aside at a slant. The base passes below the wall.

At alpha 0 the base breaks the quiet floor as it sets off; at alpha 1 the hand is not
accurate enough for the window. So alpha has to fall at the wall. The script steers to
the window, along its middle line and to the goal, at alpha 1 while the floor is quiet
and 0 from there on.
"""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from marl_mm.declared import check_positive
from marl_mm.envs.cruise import (
    ALPHA,
    BASE,
    DELTA,
    GOAL,
    HAND,
    HAND_Y,
    MODE,
    Targets,
    names,
)
from marl_mm.envs.hazard import HazardTask
from marl_mm.envs.intervals import Interval
from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Values
from marl_mm.envs.tasks.reach import steer
from marl_mm.envs.window import DISTANCE, GATE, WallConfig, Window
from marl_mm.errors import UsageError
from marl_mm.layout import Agent, Layout
from marl_mm.sim.config import Camera
from marl_mm.sim.scene import Mark

if TYPE_CHECKING:
    from marl_mm.envs.drive import Motion

LAYOUT = Layout(
    (*HAND, *BASE, MODE, *GATE, DISTANCE, *GOAL),
    (*DELTA, ALPHA),
    (
        Agent("end_effector", names(*HAND, *BASE, *GATE, *GOAL), names(*DELTA)),
        Agent("balance", names(*BASE, MODE, DISTANCE), names(ALPHA)),
    ),
    compared=names(*HAND),
    desired=names(*GOAL),
)
"""Layout of Gate: one agent sees window and goal, the other one how far the wall is."""


@dataclass(frozen=True, kw_only=True)
class Gate(HazardTask):
    """The task, with goals, wall, quiet floor and reward as fields."""

    about = "Reach a goal through a narrow window, after a way on a quiet floor."
    layout = LAYOUT
    hidden: ClassVar[dict[str, float]] = {DISTANCE.name: 9.0}
    camera = Camera(target_w=(1.0, 0.0, 0.45), distance=2.6, yaw=-40.0, pitch=-42.0)
    own_info: ClassVar[dict[str, str]] = {
        **HazardTask.own_info,
        "floor_acceleration": "largest acceleration of the base where the floor is "
        "quiet [m/s^2]",
        "window_error": "largest distance along y or z from the middle of the window "
        "within the wall [m]",
    }

    max_steps: int = 17
    """Number of steps until truncation: too few for a stable base all the way."""

    goal_x: Interval = (1.8, 1.9)
    """Interval of x of goals, world [m]."""

    goal_z: Interval = (0.5, 0.7)
    """Interval of z of goals, world [m]."""

    wall: WallConfig = field(default_factory=lambda: WallConfig(x=(1.4, 1.5)))
    """Intervals of the wall and its window."""

    quiet_until: float = 0.1
    """Distance to the wall along x beyond which the floor is quiet [m]."""

    quiet_limit: float = 0.25
    """Largest commanded acceleration of the base where the floor is quiet [m/s^2]; to
    set off at alpha 1 takes 0.18."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "quiet_limit")
        near, end, start = self.wall.x[0], self.wall.end, self.stand_off
        if not start + self.quiet_until < near <= end < self.goal_x[0]:
            raise UsageError(
                f"a wall at {near:g} to {end:g} m is not between the start at "
                f"{start:g} m and the goals at {self.goal_x[0]:g} m"
            )
        self._check_detour()

    def _check_detour(self) -> None:
        """Refuse a window so far aside that no hand gets through it to the goal."""
        far, wall_y = self.wall.x[1], self.wall.y
        # A step moves each axis by up to action_scale: the longest one sets the time.
        there = max(far - self.stand_off, *(abs(y - HAND_Y) for y in wall_y))
        aside = max(abs(goal - window) for goal in self.goal_y for window in wall_y)
        way = there + max(self.goal_x[1] - far, aside) - self.success_distance
        if way > (longest := self.action_scale * self.max_steps):
            raise UsageError(
                f"wall.y is {wall_y[0]:g} to {wall_y[1]:g} m, a way of {way:.2f} m "
                f"through the window to the goal, expected at most {longest:g} m, as "
                f"far as a hand goes in max_steps, {self.max_steps}"
            )

    def draw(self, rng: np.random.Generator) -> Window:
        """Draw the window of an episode."""
        return self.wall.draw(rng)

    def marks(self, hazard: Window) -> list[Mark]:
        """Walls on both sides of the window, in slices."""
        return hazard.walls(self.wall.thickness, self.wall.clearance)

    def observe(self, attempt: Attempt) -> Values:
        """Joint state of hand and base, the window, and the distance to the wall."""
        seen, window = super().observe(attempt), attempt.memory.drawn
        distance = window.x - seen[HAND[0].name]
        own = dict(zip(names(*GATE, DISTANCE), (*window, distance), strict=True))
        return {**seen, **own}

    def harm(self, targets: Targets, motion: "Motion") -> tuple[str, dict[str, float]]:
        """Too large an acceleration on the quiet floor, or a touch of the wall."""
        window: Window = targets.drawn
        quiet = motion.hand_w[:, 0] < window.x - self.quiet_until
        largest = np.abs(motion.base_acceleration[quiet]).max(initial=0.0)
        error = window.error(motion.hand_w, self.wall.thickness)
        reason = ""
        if largest > self.quiet_limit:
            reason = "the base was not quiet before the wall"
        elif error > self.wall.clearance:
            reason = "the hand touched the wall"
        return reason, {
            "floor_acceleration": float(largest),
            "window_error": error,
        }

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        """Steer to the window, through it and to the goal; alpha falls at the wall."""
        hand, goal = (
            np.array([state[entry.name] for entry in entries])
            for entries in (HAND, GOAL)
        )
        window = Window(*(state[name] for name in names(*GATE)))
        beyond = hand[0] > window.x + self.wall.thickness
        before = goal[0] < window.x  # the goal of a first half, see ``halves``
        way = goal - hand
        if not (beyond or before):
            way = window.way(hand, self.action_scale)
        quiet = state[DISTANCE.name] > self.quiet_until
        alpha = 1.0 if quiet else script.alpha
        return steer(script.kp * way) | {ALPHA.name: alpha}


_MEDIUM = Gate()

register_task(
    "Gate-easy-v0",
    replace(
        _MEDIUM,
        max_steps=20,
        wall=replace(_MEDIUM.wall, clearance=0.035, slope=(0.3, 0.5)),
    ),
)
register_task("Gate-v0", _MEDIUM)
register_task(
    "Gate-hard-v0",
    replace(
        _MEDIUM,
        max_steps=16,
        quiet_limit=0.2,
        wall=replace(_MEDIUM.wall, thickness=0.25, clearance=0.015, slope=(0.7, 1.0)),
    ),
)
register_task("Gate-halves-v0", replace(_MEDIUM, halves=True))
