"""Gate: bring the end-effector through a window in a thick wall to a goal beyond.

The hand's agent sees window and goal, the balance agent only how far the wall is from
the hand. As long as that is more than ``quiet_until``, the floor is quiet: an episode
fails if the base is told to accelerate by more than ``quiet_limit``. Within the wall it
fails if the finger tips are further than ``clearance`` from the middle of the window,
which goes aside at a slant.

At alpha 0 the base breaks the quiet floor as it sets off; at alpha 1 the hand is not
accurate enough for the window. So alpha has to fall at the wall. The script steers to
the window, along its middle line and to the goal, at alpha 1 while the floor is quiet
and 0 from there on.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from marl_mm.envs.cruise import ALPHA, BASE, DELTA, GOAL, HAND, MODE, Targets, names
from marl_mm.envs.hazard import HazardTask, Interval, check_intervals
from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Values
from marl_mm.envs.tasks.reach import steer
from marl_mm.errors import UsageError
from marl_mm.layout import Agent, Entry, Layout
from marl_mm.sim.config import Camera
from marl_mm.sim.scene import YELLOW, Mark

if TYPE_CHECKING:
    from marl_mm.envs.drive import Motion

GATE = (
    *(Entry(f"gate_{axis}", "m") for axis in "xyz"),
    Entry("gate_slope", "1", -1.0, 1.0),
)
"""Middle of the window on the wall's near side, world frame, and its way aside per way
ahead through the wall."""

DISTANCE = Entry("gate_distance", "m")
"""Distance along x from the end-effector to the wall's near side; negative beyond."""

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

AIM = 0.01
"""Distance at which the script is at the point before the window [m]."""


class Window(NamedTuple):
    """Window of an episode, as the entries of the state."""

    x: float
    y: float
    z: float
    slope: float

    def error(self, hand_w: np.ndarray, thickness: float) -> float:
        """Largest distance along y or z from the window's middle within the wall [m].

        Args:
            hand_w: Positions of the hand, shape (n, 3) [m].
            thickness: Way through the wall [m].
        """
        x, y, z = hand_w.T
        ahead = x - self.x
        within = (ahead > 0) & (ahead < thickness)
        aside = np.abs(y - self.y - self.slope * ahead)
        error = np.maximum(aside, np.abs(z - self.z))[within]
        return float(error.max(initial=0.0))

    def walls(self, thickness: float, clearance: float) -> list[Mark]:
        """Drawings of the wall on both sides of the window, in slices.

        Args:
            thickness: Way through the wall [m].
            clearance: Half width of the window for the finger tips [m].
        """
        count, wide = 8, 0.3
        deep = thickness / count
        marks = []
        for ahead in (np.arange(count) + 0.5) * deep:
            for side in (-1, 1):
                aside = side * (clearance + 0.02 + wide / 2)
                middle = self.y + self.slope * ahead + aside
                place = float(self.x + ahead), float(middle), self.z / 2
                marks.append(Mark(place, (deep, wide, self.z), YELLOW))
        return marks

    def way(self, hand: np.ndarray, step: float) -> np.ndarray:
        """The script's next displacement of the hand to the window or within it.

        Args:
            hand: Position of the hand before or in the wall, shape (3,) [m].
            step: Way ahead in a step [m].
        """
        middle = np.array([self.x, self.y, self.z])
        ahead, along = hand[0] - self.x, np.array([1.0, self.slope, 0.0])
        if ahead > -2 * AIM and np.abs(hand - middle - ahead * along).max() < AIM:
            return np.asarray(middle + (ahead + step) * along - hand)
        return np.asarray(middle - AIM * along - hand)


@dataclass(frozen=True, kw_only=True)
class Gate(HazardTask):
    """Parameters of goals, wall, window and reward.

    Only the finger tips are held against the window: the hand points down, and the
    arm's last links pass above the wall.
    """

    about = "Reach a goal through a narrow window, after a way on a quiet floor."
    layout = LAYOUT
    hidden: ClassVar[dict[str, float]] = {DISTANCE.name: 9.0}
    camera = Camera(target_w=(1.1, 0.0, 0.4), distance=2.4, yaw=40.0, pitch=-35.0)
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

    wall_x: Interval = (1.4, 1.5)
    """Interval of x of the wall's near side, world [m]."""

    wall_thickness: float = 0.2
    """Way through the wall along x [m]."""

    window_y: Interval = (-0.05, 0.05)
    """Interval of y of the window's middle at the near side, world [m]."""

    window_z: Interval = (0.57, 0.63)
    """Interval of z of the window's middle, world [m]."""

    window_slope: Interval = (0.5, 0.8)
    """Interval of the window's way aside per way ahead, to either side."""

    clearance: float = 0.025
    """Half width and half height of the window, for the finger tips [m]."""

    quiet_until: float = 0.1
    """Distance of the end-effector to the wall up to which the floor is quiet [m]."""

    quiet_limit: float = 0.25
    """Largest commanded acceleration of the base where the floor is quiet [m/s^2]; to
    set off at alpha 1 takes 0.18."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_intervals(self, "wall_x", "window_y", "window_z", "window_slope")
        end, least = self.wall_x[1] + self.wall_thickness, self.stand_off
        if not least + self.quiet_until < self.wall_x[0] <= end < self.goal_x[0]:
            raise UsageError(
                f"a wall at {self.wall_x[0]:g} to {end:g} m is not between the start "
                f"at {least:g} m and the goals at {self.goal_x[0]:g} m"
            )
        if not 0.0 <= self.window_slope[0] <= self.window_slope[1] <= 1.0:
            low, high = self.window_slope
            raise UsageError(
                f"window_slope is {low:g} to {high:g}, expected within 0 to 1: no step "
                "goes further aside than ahead"
            )

    def draw(self, rng: np.random.Generator) -> Window:
        """The window."""
        intervals = self.wall_x, self.window_y, self.window_z, self.window_slope
        x, y, z, slope = (rng.uniform(*interval) for interval in intervals)
        return Window(x, y, z, slope if rng.random() < 0.5 else -slope)

    def marks(self, hazard: Window) -> list[Mark]:
        """Walls on both sides of the window, in slices."""
        return hazard.walls(self.wall_thickness, self.clearance)

    def observe(self, attempt: Attempt) -> Values:
        """Joint state of hand and base, the window, and the distance to the wall."""
        seen, window = super().observe(attempt), attempt.memory.drawn
        distance = window.x - seen[HAND[0].name]
        own = dict(zip(names(*GATE, DISTANCE), (*window, distance), strict=True))
        return {**seen, **own}

    def harm(self, targets: Targets, motion: "Motion") -> tuple[str, dict[str, float]]:
        """An acceleration on the quiet floor, or a touch of the wall."""
        window: Window = targets.drawn
        before = motion.hand_w[:, 0] < window.x - self.quiet_until
        felt = np.abs(motion.base_acceleration[before]).max(initial=0.0)
        error = window.error(motion.hand_w, self.wall_thickness)
        reason = ""
        if felt > self.quiet_limit:
            reason = "the base was not quiet before the wall"
        elif error > self.clearance:
            reason = "the hand touched the wall"
        return reason, {
            "floor_acceleration": float(felt),
            "window_error": error,
        }

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        """Steer to the window, through it and to the goal; alpha falls at the wall."""
        hand, goal = (
            np.array([state[entry.name] for entry in entries])
            for entries in (HAND, GOAL)
        )
        window = Window(*(state[name] for name in names(*GATE)))
        beyond = hand[0] > window.x + self.wall_thickness
        before = goal[0] < window.x  # half way
        way = goal - hand
        if not (beyond or before):
            way = window.way(hand, self.action_scale)
        quiet = state[DISTANCE.name] > self.quiet_until
        alpha = 1.0 if quiet else script.alpha
        return steer(script.kp * way) | {ALPHA.name: alpha}


_MEDIUM = Gate()

register_task(
    "Gate-easy-v0",
    replace(_MEDIUM, max_steps=20, clearance=0.035, window_slope=(0.3, 0.5)),
)
register_task("Gate-v0", _MEDIUM)
register_task(
    "Gate-hard-v0",
    replace(_MEDIUM, clearance=0.02, window_slope=(0.7, 1.0), quiet_limit=0.2),
)
register_task("Gate-halves-v0", replace(_MEDIUM, halves=True))
