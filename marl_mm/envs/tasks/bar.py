"""Bar: two robots carry a bar past a beam between them, over it or under it.

Each robot has two agents, which see their own robot, the beam, and where the other
robot's hand was a step ago. The hands see the goal, too. An episode fails if the bar
tilts by more than ``largest_tilt``, if the hands are not the bar's length apart, to
within ``largest_stretch``, if the bar touches the beam, or if an arm collides.

Over the beam is as good as under it, if both robots go the same way. A team of which
the halves go by different conventions tilts the bar, and the mean of both touches the
beam. The script goes over, or by its convention ``under`` below. Alpha decides little
here: the script sets it to 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import acos, sqrt
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from marl_mm.declared import check_positive
from marl_mm.envs.cruise import (
    ALPHA,
    BASE,
    DELTA,
    HAND,
    HAND_Y,
    MODE,
    CruiseTask,
    names,
)
from marl_mm.envs.hazard import RiskyTask
from marl_mm.envs.intervals import Interval, check_intervals, check_within
from marl_mm.envs.load import HIGH
from marl_mm.envs.order import Order
from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Values
from marl_mm.envs.tasks.reach import steer
from marl_mm.errors import UsageError
from marl_mm.layout import Agent, Entry, Layout
from marl_mm.sim.config import Camera
from marl_mm.sim.scene import GREY, YELLOW, Block, Mark, Scene

if TYPE_CHECKING:
    from marl_mm.envs.drive import Motion

BEADS = 21
"""Number of balls that draw the bar in a picture."""

BEAD = 0.015
"""Radius of such a ball [m]."""

SIDES = ("left", "right")
"""Names of the robots; the right one stands at the bar's length beside the left one."""

BEAM = (Entry("beam_x", "m"), Entry("beam_z", "m"))
"""Place of the beam, world frame."""

MIDDLE = (Entry("bar_x", "m"), Entry("bar_z", "m"))
"""Place of the bar's middle, world frame."""

GOAL = (Entry("goal_x", "m"), Entry("goal_z", "m"))
"""Goal of the bar's middle, world frame."""

LATE = tuple(Entry(f"late_{axis}", "m") for axis in "xyz")
"""Position of the end-effector a step ago, in the frame of its robot's start."""


def _of(side: str, *entries: Entry) -> tuple[Entry, ...]:
    return tuple(replace(entry, name=f"{side}_{entry.name}") for entry in entries)


def _agents(side: str, other: str) -> tuple[Agent, Agent]:
    seen = names(*_of(side, *HAND, *BASE), *_of(other, *LATE), *BEAM)
    return (
        Agent(f"{side}_hand", (*seen, *names(*GOAL)), names(*_of(side, *DELTA))),
        Agent(
            f"{side}_balance",
            (*seen, *names(*_of(side, MODE))),
            names(*_of(side, ALPHA)),
        ),
    )


LAYOUT = Layout(
    (
        *(entry for side in SIDES for entry in _of(side, *HAND, *BASE, MODE, *LATE)),
        *(*BEAM, *MIDDLE, *GOAL),
    ),
    tuple(entry for side in SIDES for entry in _of(side, *DELTA, ALPHA)),
    (*_agents(*SIDES), *_agents(*SIDES[::-1])),
    compared=names(*MIDDLE),
    desired=names(*GOAL),
)
"""Layout of Bar: the agents of a robot see it, the beam, and where the other robot's
hand was a step ago. The hands see the goal, too."""


@dataclass
class Pair:
    """Two robots in an episode."""

    sides: tuple[Attempt, Attempt]
    """The episode of each robot, in the order of ``SIDES``."""

    beam: np.ndarray
    """Place of the beam, x and z, shape (2,) [m]."""

    late_w: np.ndarray
    """Positions of the hands a step ago, shape (2, 3) [m]."""

    failure: str = ""
    """Reason of the failure; empty without one."""

    measured: dict[str, float] = field(default_factory=dict)
    """Step numbers of the bar, by name."""


@dataclass(frozen=True, kw_only=True)
class Bar(RiskyTask):
    """The task, with goals, bar and beam as fields.

    Each robot is simulated by itself, with half of the bar's mass in its hand. The bar
    is a straight line between the hands, and a failure where it cannot be. The beam
    reaches into the gap between the robots, where only the bar can touch it.
    """

    about = "Two robots carry a bar to a goal behind: both over a beam, or both under."
    layout = LAYOUT
    camera = Camera(target_w=(0.0, 0.0, 0.5), distance=2.0, yaw=-75.0, pitch=-16.0)
    robots = 2
    conventions = ("over", "under")
    handles: ClassVar[bool] = True
    own_info: ClassVar[dict[str, str]] = {
        **{
            name: f"{text}; of two hands and bases the larger"
            for name, text in CruiseTask.own_info.items()
        },
        "bar_tilt": "largest angle of the bar to its place at the start [rad]",
        "bar_stretch": "largest distance of the hands' distance to the length [m]",
        "beam_gap": "least distance of the bar's middle to the beam's middle [m]",
    }

    max_steps: int = 13
    """Number of steps until truncation."""

    goal_x: Interval = (-0.45, -0.35)
    """Interval of x of goals, world [m]."""

    goal_z: Interval = (0.55, 0.65)
    """Interval of z of goals, world [m]."""

    beam_x: Interval = (0.3, 0.4)
    """Interval of x of the beam, world [m]."""

    beam_z: Interval = (0.57, 0.6)
    """Interval of z of the beam, world [m]; the hands start at 0.586."""

    beam_size: float = 0.07
    """Distance of the bar's middle to the beam's middle at which they touch [m]."""

    bar_length: float = 0.8
    """Length of the bar, and distance of the robots [m]."""

    bar_mass: float = 2.0
    """Mass of the bar [kg]."""

    largest_tilt: float = 10.0
    """Angle of the bar to its place at the start at which it falls [deg]."""

    largest_stretch: float = 0.03
    """Distance of the hands' distance to the bar's length at which it falls [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_intervals(self, "goal_x", "goal_z", "beam_x", "beam_z")
        check_positive(self, "beam_size", "bar_length", "bar_mass")
        check_positive(self, "largest_tilt", "largest_stretch")
        for name in ("goal_z", "beam_z"):
            check_within(name, getattr(self, name), (0.0, HIGH), "what a hand reaches")
        near = -self.success_distance
        self.check_way("goal_", self.goal_x, near, self.max_steps)
        near, far = self.stand_off - self.beam_size, self.goal_x[1] + self.beam_size
        if not near > self.beam_x[1] >= self.beam_x[0] > far:
            low, high = self.beam_x
            raise UsageError(
                f"beam_x is {low:g} to {high:g} m, expected between goals and start: "
                f"within {far:g} to {near:g}"
            )

    # --- The episode ---------------------------------------------------------

    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        """Draw goal and beam, and let both robots hold the bar for one step."""
        drawn = np.array([rng.uniform(*self.goal_x), rng.uniform(*self.goal_z)])
        beam = np.array([rng.uniform(*self.beam_x), rng.uniform(*self.beam_z)])
        attempt.goal = drawn if goal is None else goal
        left, right = (Attempt(self, [drive]) for drive in attempt.drives)
        pair = attempt.memory = Pair((left, right), beam, np.empty((2, 3)))
        orders = [
            self._take(robot, self._marks(side, beam, attempt.goal))
            for side, robot in enumerate(pair.sides)
        ]
        attempt.follow(orders)  # one unseen step
        pair.late_w = self._hands_w(pair)

    def _take(self, robot: Attempt, marks: Sequence[Mark]) -> Order:
        (drive,) = robot.drives
        start_w = drive.start_w()
        x, y, z = start_w.tolist()
        half = Block((0.04, 0.04, 0.04), self.bar_mass / 2)
        scene = Scene(half, (x, y, z), grasp="weld")
        self.place(robot, tuple(marks), scene)
        drive.handle(scene, "given").take(self.hand_w(robot))
        return self.hold(robot, start_w)

    def act(self, attempt: Attempt, action: Values) -> list[Order]:
        """Move both hands' targets, and plan both bases."""
        pair: Pair = attempt.memory
        pair.late_w = self._hands_w(pair)
        orders = []
        for side, robot in zip(SIDES, pair.sides, strict=True):
            part = {name: action[f"{side}_{name}"] for name in names(*DELTA, ALPHA)}
            orders += super().act(robot, part)
        return orders

    def at_step(self, attempt: Attempt, motions: "Sequence[Motion]") -> None:
        """Look whether the bar fell or touched the beam; the first failure counts."""
        pair: Pair = attempt.memory
        left, right = (motion.hand_w for motion in motions)
        along = right - left + np.array([0.0, -self.bar_length, 0.0])
        length = np.linalg.norm(along, axis=1)
        cosine = float((-along[:, 1] / length).min())
        # The last bit of numpy's arccos depends on the processor.
        tilt = acos(max(-1.0, min(cosine, 1.0)))
        stretch = np.abs(length - self.bar_length).max()
        gap = np.linalg.norm((left + right)[:, [0, 2]] / 2 - pair.beam, axis=1).min()
        reason = ""
        if tilt > np.deg2rad(self.largest_tilt):
            reason = "the bar tilted"
        elif stretch > self.largest_stretch:
            reason = "the hands are not a bar's length apart"
        elif gap < self.beam_size:
            reason = "the bar touched the beam"
        pair.failure = pair.failure or reason
        pair.measured = {
            "bar_tilt": tilt,
            "bar_stretch": float(stretch),
            "beam_gap": float(gap),
        }

    def observe(self, attempt: Attempt) -> Values:
        """Joint states of both robots, beam and bar."""
        pair: Pair = attempt.memory
        seen: dict[str, float] = {}
        for side, robot, late in zip(SIDES, pair.sides, pair.late_w, strict=True):
            part = {
                **super().observe(robot),
                **dict(zip(names(*LATE), late, strict=True)),
            }
            seen |= {f"{side}_{name}": value for name, value in part.items()}
        middle = self._hands_w(pair).mean(axis=0)[[0, 2]]
        own = dict(zip(names(*BEAM, *MIDDLE), (*pair.beam, *middle), strict=True))
        return {**seen, **own}

    def measure(self, attempt: Attempt) -> dict[str, Any]:
        """Distances of hands and bases to their targets [m], and the bar's numbers."""
        pair: Pair = attempt.memory
        left, right = (super(Bar, self).measure(robot) for robot in pair.sides)
        return {name: max(left[name], right[name]) for name in left} | pair.measured

    def failure(self, attempt: Attempt) -> str:
        """What happened to the bar, or the collision of a hand."""
        pair: Pair = attempt.memory
        hands = (robot.drives[0].hand for robot in pair.sides)
        return pair.failure or next((h.failure for h in hands if h and h.failure), "")

    def _hands_w(self, pair: Pair) -> np.ndarray:
        return np.stack([self.hand_w(robot) for robot in pair.sides])

    def _marks(self, side: int, beam: np.ndarray, goal: np.ndarray) -> list[Mark]:
        x, z = beam.tolist()
        middle = HAND_Y + (0.5 - side) * -self.bar_length
        # A bar's surface passes its edges.
        edge = sqrt(2) * max(self.beam_size - BEAD, 0.0)
        return [
            Mark((float(goal[0]), middle, float(goal[1]))),
            Mark((x, middle, z), (edge, 0.2, edge), YELLOW),
            *[Mark((0.0, 0.0, -1.0), (BEAD,), GREY)] * BEADS,
        ]

    def moved_marks(self, attempt: Attempt) -> list[dict[int, tuple[float, ...]]]:
        """The bar, as beads between the hands."""
        pair: Pair = attempt.memory
        hands = self._hands_w(pair)
        along = np.linspace(0.0, 1.0, BEADS)[:, None]
        moved = []
        for side in (0, 1):
            aside = np.array([0.0, (1 - 2 * side) * -self.bar_length, 0.0])
            beads = hands[side] + along * (hands[1 - side] + aside - hands[side])
            moved.append({2 + i: tuple(b) for i, b in enumerate(beads.tolist())})
        return moved

    # --- Expert --------------------------------------------------------------

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        """Both hands go over the beam, or both under it, and then to the goal."""
        rise = 1.5 * self.beam_size
        under = script.convention == "under"
        action: dict[str, float] = {}
        for side in SIDES:
            x, z = state[f"{side}_end_effector_x"], state[f"{side}_end_effector_z"]
            height = state["beam_z"] + (-rise if under else rise)
            if x < state["beam_x"] - self.beam_size:
                height = state["goal_z"]
            way = np.array([state["goal_x"] - x, 0.0, height - z])
            own = steer(script.kp * way) | {ALPHA.name: script.alpha}
            action |= {f"{side}_{name}": value for name, value in own.items()}
        return action


_MEDIUM = Bar()

register_task(
    "Bar-easy-v0",
    replace(_MEDIUM, beam_size=0.05, largest_tilt=14.0, largest_stretch=0.05),
)
register_task("Bar-v0", _MEDIUM)
register_task(
    "Bar-hard-v0",
    replace(_MEDIUM, beam_size=0.08, largest_tilt=8.0, largest_stretch=0.02),
)
