"""Course: take a block, cross a quiet zone, pass a gate, deliver it, and come back.

The five sub-goals count in this order only. The hand's agent sees block, stand, window
and bin, the balance agent the quiet zone and how far the wall is from the hand; both
see how many sub-goals are reached. An episode fails if the base is told to accelerate
by more than ``zone_limit`` in the zone, if the finger tips are further than
``wall.clearance`` from the middle of the window within the wall, or as in Grasp, until
the block is delivered. The base passes below the wall.

So alpha has to be high in the zone, and low at the wall and where the time is short.
The script takes, crosses, passes, delivers and comes back, with alpha at 1 from 15 cm
before the zone to its end and 0 elsewhere. Rewards do not depend on the goal, so that
hindsight teaches nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from marl_mm.declared import check_positive
from marl_mm.envs.course_layout import BIN, LAYOUT, STAGE, STAGES, ZONE
from marl_mm.envs.cruise import (
    ALPHA,
    HAND,
    CruiseTask,
    Targets,
    names,
)
from marl_mm.envs.grasping import LIFT, grasping
from marl_mm.envs.intervals import Interval, check_intervals, check_within
from marl_mm.envs.load import StandConfig, check_reach
from marl_mm.envs.order import Order
from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Terms, Values
from marl_mm.envs.tasks.grasp import (
    BLOCK,
    GRIP,
    OPENING,
    STAND,
    handled,
    holds_clear,
)
from marl_mm.envs.tasks.quiet_zone import BRAKING, felt_within
from marl_mm.envs.tasks.reach import steer
from marl_mm.envs.terms import goal_distance, length
from marl_mm.envs.window import DISTANCE, GATE, WallConfig, Window
from marl_mm.episode import FAILED
from marl_mm.errors import UsageError
from marl_mm.sim.config import Camera
from marl_mm.sim.scene import YELLOW, Mark

if TYPE_CHECKING:
    from marl_mm.envs.drive import Motion


_WITHOUT_EFFECT = {
    "failure_reward": "`failure_reward` is the reward of all failures",
    "lift": "the block goes to the bin",
}
"""Settings of the block that other tasks use, and why this one does not."""


class Stations(NamedTuple):
    """What an episode has on its way."""

    zone: np.ndarray
    """Near and far end of the quiet zone, shape (2,) [m]."""

    window: Window
    """Window in the wall."""

    bin_w: np.ndarray
    """Place over the bin, shape (3,) [m]."""


@dataclass
class Way(Targets):
    """Targets, and how far the team has come."""

    stage: int = 0
    """Number of sub-goals reached."""

    points: int = 0
    """Number of sub-goals reached in the last step."""


@dataclass(frozen=True, kw_only=True)
class Course(CruiseTask):
    """The task, with block, zone, wall, bin and reward as fields."""

    about = "Take a block, cross a quiet zone, pass a gate, deliver it, and come back."
    layout = LAYOUT
    handles: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("points",)
    hidden: ClassVar[dict[str, float]] = {
        **dict.fromkeys(names(*ZONE), -9.0),
        DISTANCE.name: 9.0,
    }
    camera = Camera(target_w=(2.4, 0.0, 0.3), distance=4.3, yaw=12.0, pitch=-32.0)
    own_info: ClassVar[dict[str, str]] = {
        **CruiseTask.own_info,
        "points": "number of sub-goals reached in the step",
        "zone_acceleration": "largest acceleration of the base in the zone [m/s^2]",
        "window_error": "largest distance along y or z from the middle of the window "
        "within the wall [m]",
    }

    max_steps: int = 84
    """Number of steps until truncation: too few for a stable base all the way."""

    load: StandConfig = field(default_factory=lambda: StandConfig(mass=(0.05, 1.0)))
    """Intervals of the block and its stand."""

    zone_x: Interval = (0.5, 1.1)
    """Interval of x in which the zone lies, of the base, world [m]."""

    zone_length: Interval = (0.3, 0.4)
    """Interval of the length of the zone [m]."""

    zone_limit: float = 0.15
    """Largest commanded acceleration of the base within the zone [m/s^2]."""

    wall: WallConfig = field(default_factory=lambda: WallConfig(x=(4.0, 4.2)))
    """Intervals of the wall and its window."""

    bin_x: Interval = (4.55, 4.65)
    """Interval of x of the bin, world [m]."""

    bin_y: Interval = (-0.1, 0.1)
    """Interval of y of the bin, world [m]."""

    bin_z: float = 0.6
    """Height at which the block is let go over the bin [m]."""

    success_distance: float = 0.05
    """Distance of the block to its place over the bin at which it is delivered [m]."""

    failure_reward: float = -1.0
    """Reward of a failure."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_intervals(self, "zone_x", "bin_x", "bin_y")
        check_positive(self, "zone_length", "zone_limit", "success_distance")
        near, far = self.zone_x
        if self.zone_length[1] > far - near or near < BRAKING:
            raise UsageError(
                f"a zone of {self.zone_length[1]:g} m does not fit into zone_x, "
                f"{near:g} to {far:g} m, at least {BRAKING:g} m from the start"
            )
        start, end = self.wall.x[0], self.wall.end
        if not far + self.stand_off < start <= end < self.bin_x[0]:
            raise UsageError(
                f"a wall at {start:g} to {end:g} m is not between zone and bin at "
                f"{self.bin_x[0]:g} m"
            )
        if not self.failure_reward < 0:
            raise UsageError(
                f"failure_reward is {self.failure_reward}, expected below 0"
            )
        for name, instead in _WITHOUT_EFFECT.items():
            given, unused = (getattr(of, name) for of in (self.load, StandConfig()))
            if given != unused:
                raise UsageError(
                    f"load.{name} is {given:g}, expected {unused:g}, as it has no "
                    f"effect here: {instead}"
                )
        self._check_block()

    def _check_block(self) -> None:
        """Refuse a block that cannot be taken, held or delivered in time."""
        stand = self.load
        check_reach("load.stand_", stand.stand_y, stand.stand_height)
        check_reach("bin_", self.bin_y, (self.bin_z, self.bin_z))
        before = self.zone_x[0] + self.stand_off
        reach = -before, before
        check_within("load.stand_x", stand.stand_x, reach, "in reach before the zone")
        back = self.bin_x[1] - self.wall.x[0]
        near = back - self.success_distance
        self.check_way("bin_", self.bin_x, near, self.max_steps, self.bin_y)
        stand.check_hold(self.max_steps * self.ticks_per_step)

    @property
    def highest_return(self) -> float:
        """A point for each sub-goal."""
        return float(len(STAGES))

    # --- The episode ---------------------------------------------------------

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        """Draw block, zone, window and bin, and open the hand."""
        scene, there = self.load.draw_scene(rng), self._draw(rng)
        wanted = np.array([float(len(STAGES))])
        attempt.goal = wanted if goal is None else goal
        near, far = there.zone.tolist()
        marks = (
            Mark(tuple(there.bin_w.tolist()), (0.02,)),
            Mark(((near + far) / 2, 0.0, 0.002), (far - near, 1.2, 0.004), YELLOW),
            *there.window.walls(self.wall.thickness, self.wall.clearance),
        )
        self.place(attempt, marks, scene)
        attempt.memory = Way(**vars(attempt.memory) | {"drawn": there})
        attempt.drives[0].handle(scene, self.load.knowledge).grip(False)

    def _draw(self, rng: np.random.Generator) -> Stations:
        length = rng.uniform(*self.zone_length)
        near = rng.uniform(self.zone_x[0], max(self.zone_x[1] - length, self.zone_x[0]))
        window = self.wall.draw(rng)
        bin_w = np.array([rng.uniform(*self.bin_x), rng.uniform(*self.bin_y)])
        return Stations(
            np.array([near, near + length]), window, np.append(bin_w, self.bin_z)
        )

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        """Close or open the hand, and move it as in Reach."""
        way: Way = attempt.memory
        hand, closes = attempt.drives[0].hand, action[GRIP.name] > 0
        way.points = 0
        if hand is not None:
            if hand.held and not closes and self._over_bin(attempt):
                self._reach(way, "deliver")
            hand.grip(closes)
        return super().act(attempt, action)

    def at_step(self, attempt: Attempt, motions: "Sequence[Motion]") -> None:
        """Look which sub-goal was reached, and what went wrong."""
        way, (motion,) = attempt.memory, motions
        there: Stations = way.drawn
        felt = felt_within(there.zone[None], motion)
        error = there.window.error(motion.hand_w, self.wall.thickness)
        if felt > self.zone_limit:
            way.failure = way.failure or "the base was not quiet in the zone"
        elif error > self.wall.clearance:
            way.failure = way.failure or "the hand touched the wall"
        beyond = there.window.x + self.wall.thickness
        if holds_clear(attempt, self.load.hold_ticks):
            self._reach(way, "take")
            if attempt.drives[0].state.q[0] > there.zone[1]:
                self._reach(way, "cross")
            if self.hand_w(attempt)[0] > beyond:
                self._reach(way, "pass")
        elif way.stage == len(STAGES) - 1 and self.hand_w(attempt)[0] < there.window.x:
            self._reach(way, "return")
        way.measured = {
            "points": float(way.points),
            "zone_acceleration": felt,
            "window_error": error,
        }

    def _over_bin(self, attempt: Attempt) -> bool:
        block_w, _ = attempt.drives[0].world.handling.block_w()
        gap = goal_distance(block_w, attempt.memory.drawn.bin_w)
        return bool(gap < self.success_distance)

    def _reach(self, way: Way, name: str) -> None:
        """Count a sub-goal if it is the next one."""
        if STAGES[way.stage : way.stage + 1] == (name,):
            way.stage += 1
            way.points += 1

    def observe(self, attempt: Attempt) -> Values:
        """Joint state of hand, base and block, and what is on the way."""
        way: Way = attempt.memory
        there: Stations = way.drawn
        seen = {
            **super().observe(attempt),
            **handled(attempt, holds_clear(attempt, self.load.hold_ticks)),
        }
        distance = there.window.x - seen[HAND[0].name]
        ahead = *there.zone, *there.window, distance, *there.bin_w, way.stage
        entries = names(*ZONE, *GATE, DISTANCE, *BIN, STAGE)
        return {**seen, **dict(zip(entries, ahead, strict=True))}

    def failure(self, attempt: Attempt) -> str:
        """What went wrong on the way, or with a block that is not delivered yet."""
        way, hand = attempt.memory, attempt.drives[0].hand
        delivered = way.stage > STAGES.index("deliver")
        lost = "" if hand is None or delivered else hand.failure
        return str(way.failure or lost)

    # --- Reward --------------------------------------------------------------

    def reached(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Whether as many sub-goals are reached as wanted."""
        return np.asarray(achieved >= desired)[..., 0]

    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """A point for each sub-goal of the step, or the reward of a failure."""
        points = np.asarray(terms["points"], np.float64)
        return np.where(terms[FAILED].astype(bool), self.failure_reward, points)

    # --- Expert --------------------------------------------------------------

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        """Sub-goal by sub-goal; alpha is 1 where the base has to be quiet."""
        hand, block, stand, bin_w = (
            np.array([state[entry.name] for entry in entries])
            for entries in (HAND, BLOCK, STAND, BIN)
        )
        window = Window(*(state[name] for name in names(*GATE)))
        stage, closes = round(state[STAGE.name]), True
        if stage == STAGES.index("take"):
            up = stand + np.array([0.0, 0.0, LIFT])
            way, closes = grasping(hand, block, stand, up, state[OPENING.name])
        elif stage < STAGES.index("deliver"):
            way = window.way(hand, self.action_scale)
        elif stage == STAGES.index("deliver"):
            way = bin_w - block
            closes = bool(length(way) > self.success_distance / 2)
        else:
            thickness, step = self.wall.thickness, self.action_scale
            way, closes = window.way_back(hand, step, thickness), False
        near, far = (state[entry.name] for entry in ZONE)
        quiet = near - BRAKING < state["base_x"] < far
        return {
            **steer(script.kp * way),
            GRIP.name: 1.0 if closes else -1.0,
            ALPHA.name: 1.0 if quiet else script.alpha,
        }


_MEDIUM = Course()

register_task(
    "Course-easy-v0",
    replace(
        _MEDIUM,
        zone_limit=0.2,
        wall=replace(_MEDIUM.wall, thickness=0.12, clearance=0.035, slope=(0.3, 0.5)),
    ),
)
register_task("Course-v0", _MEDIUM)
register_task(
    "Course-hard-v0",
    replace(
        _MEDIUM,
        zone_limit=0.1,
        wall=replace(_MEDIUM.wall, thickness=0.3, clearance=0.015),
    ),
)
