"""Tray: bring a leaking cup to a goal behind, before it is dry, without a spill.

The hand's agent sees the goal, the balance agent the cup: its level, which falls by
``leak`` a step, and how far the liquid swings. The hand's acceleration drives the
liquid at every tick but an episode's first, which makes its first peak some 3 % lower.
An episode fails if it passes the rim, which is near in a full cup, or if the cup is
dry.

So a full cup needs short steps and a low one long steps, and the agent that makes them
does not see which it is: it sees alpha of the last step, by which the balance agent can
tell. The script's balance sets alpha to 0.6 of the level, and its hand makes the steps
that such a level allows. Teams may agree on other signals.
"""

from dataclasses import dataclass, replace
from math import hypot, pi
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from marl_mm.envs.cruise import ALPHA, BASE, DELTA, GOAL, HAND, MODE, Targets, names
from marl_mm.envs.hazard import HazardTask
from marl_mm.envs.intervals import Interval, check_intervals
from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Values
from marl_mm.envs.tasks.reach import steer, to_goal
from marl_mm.envs.terms import length
from marl_mm.errors import UsageError
from marl_mm.layout import Agent, Entry, Layout
from marl_mm.sim.config import RATE, Camera
from marl_mm.sim.scene import YELLOW, Mark

if TYPE_CHECKING:
    from marl_mm.envs.drive import Motion

LEVEL = Entry("level", "1", 0.0, 1.0)
"""Level of the cup: 1 full, 0 dry."""

SLOSH = Entry("slosh", "m", 0.0)
"""Amplitude of the liquid's motion in the cup."""

LAYOUT = Layout(
    (*HAND, *BASE, MODE, LEVEL, SLOSH, *GOAL),
    (*DELTA, ALPHA),
    (
        Agent("end_effector", names(*HAND, *BASE, MODE, *GOAL), names(*DELTA)),
        Agent("balance", names(*HAND, *BASE, MODE, LEVEL, SLOSH), names(ALPHA)),
    ),
    compared=names(*HAND),
    desired=names(*GOAL),
)
"""Layout of Tray: one agent sees the goal, the other one the cup. The first sees what
alpha the second set last."""

FULL_ALPHA = 0.6
"""Alpha by which the script's balance tells a full cup: in proportion to the level."""

CUP = (0.07, 0.07, 0.1)
"""Edges of the cup in pictures [m]."""

SWING = 0.03
"""Displacement of the liquid that a step of the hand of 0.1 m gives it, with a margin
[m]."""


@dataclass
class Cup:
    """Cup of an episode."""

    level: float
    """Level, 1 full, 0 dry."""

    motion: np.ndarray
    """Displacement of the liquid along x and y of the world [m], and its velocity
    [m/s], shape (2, 2)."""

    place: np.ndarray
    """Position of the hand at the last two ticks, shape (2, 3) [m]."""


@dataclass(frozen=True, kw_only=True)
class Tray(HazardTask):
    """The task, with goals, cup and reward as fields.

    The liquid is a mass on a damped spring along x and along y, which the hand's
    acceleration drives at every tick: linear, as for small waves. It spills where its
    displacement passes the rim, which is near in a full cup.
    """

    about = "Bring a leaking cup to a goal behind: slowly while full, soon when not."
    layout = LAYOUT
    hidden: ClassVar[dict[str, float]] = {LEVEL.name: 0.7}
    camera = Camera(target_w=(0.2, 0.0, 0.5), distance=1.9, yaw=30.0, pitch=-25.0)
    own_info: ClassVar[dict[str, str]] = {
        **HazardTask.own_info,
        "slosh_peak": "largest displacement of the liquid within the step [m]",
        "rim": "displacement at which the liquid spilled at the step's start [m]",
    }

    max_steps: int = 30
    """Number of steps until truncation; cups are dry before."""

    goal_x: Interval = (-0.1, -0.05)
    """Interval of x of goals, world [m]."""

    goal_y: Interval = (0.0, 0.2)
    """Interval of y of goals, world [m]."""

    goal_z: Interval = (0.5, 0.7)
    """Interval of z of goals, world [m]."""

    level: Interval = (0.45, 1.0)
    """Interval of the level at the start."""

    leak: float = 0.044
    """Loss of level in a step."""

    rim_dry: float = 0.028
    """Displacement at which a nearly dry cup spills [m]."""

    rim_full: float = 0.0095
    """Displacement at which a full cup spills [m]; between them it is linear."""

    frequency: float = 1.5
    """Natural frequency of the liquid [Hz]."""

    damping: float = 0.2
    """Damping ratio of the liquid."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_intervals(self, "level")
        low, high = self.level
        if not 0.0 < low <= high <= 1.0:
            raise UsageError(f"level is {low:g} to {high:g}, expected within 0 to 1")
        if not 0.0 < self.rim_full <= self.rim_dry:
            raise UsageError(
                f"rim_full is {self.rim_full:g} m, expected > 0 and at most rim_dry, "
                f"{self.rim_dry:g} m"
            )
        if not (self.leak > 0 and self.frequency > 0 and 0 <= self.damping < 1):
            raise UsageError(
                f"leak is {self.leak:g}, frequency {self.frequency:g}, damping "
                f"{self.damping:g}, expected > 0, > 0, and 0 to 1"
            )
        # Beyond, the steps of the liquid's motion make it grow.
        most = RATE / pi * (hypot(1, self.damping) - self.damping)
        if self.frequency >= most:
            raise UsageError(
                f"frequency is {self.frequency:g} Hz, expected below {most:.3g} Hz at "
                f"{RATE} ticks a second and damping {self.damping:g}"
            )
        steps = int(low / self.leak + 1e-9)
        self.check_way(
            f"a cup of level {low:g} is dry in {steps} steps: goal_",
            self.goal_x,
            -self.success_distance,
            steps,
            self.goal_y,
        )

    def draw(self, rng: np.random.Generator) -> Cup:
        """The cup, at rest."""
        return Cup(rng.uniform(*self.level), np.zeros((2, 2)), np.empty((0, 3)))

    def marks(self, hazard: Cup) -> list[Mark]:
        """The cup."""
        return [Mark((0.0, 0.0, -1.0), CUP, YELLOW)]

    def moved_marks(self, attempt: Attempt) -> list[dict[int, tuple[float, ...]]]:
        """The cup, in the hand."""
        return [{1: tuple(self.hand_w(attempt).tolist())}]

    def observe(self, attempt: Attempt) -> Values:
        """Joint state of hand and base, and the cup."""
        cup: Cup = attempt.memory.drawn
        amplitude = hypot(*cup.motion[0], *(cup.motion[1] / (2 * pi * self.frequency)))
        own = {LEVEL.name: cup.level, SLOSH.name: amplitude}
        return {**super().observe(attempt), **own}

    def harm(self, targets: Targets, motion: "Motion") -> tuple[str, dict[str, float]]:
        """A spill, or a cup that is dry."""
        from marl_mm.envs.slosh import swing  # numba is not needed before a step

        cup: Cup = targets.drawn
        path = np.concatenate([cup.place, motion.hand_w])
        cup.place = path[-2:].copy()
        rim = self.rim_dry + (self.rim_full - self.rim_dry) * cup.level
        peak = swing(path, cup.motion, 2 * pi * self.frequency, self.damping)
        cup.level = max(cup.level - self.leak, 0.0)
        reason = ""
        if peak > rim:
            reason = "the cup spilled"
        elif cup.level == 0.0:
            reason = "the cup is dry"
        return reason, {"slosh_peak": peak, "rim": rim}

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        """Steps as long as the level that alpha tells allows, straight to the goal."""
        level = min(state[MODE.name] / FULL_ALPHA, 1.0)
        rim = self.rim_dry + (self.rim_full - self.rim_dry) * level
        longest = rim / SWING
        way = script.kp * to_goal(state)
        way *= min(1.0, longest / max(float(length(way)), longest))
        return steer(way) | {ALPHA.name: FULL_ALPHA * state[LEVEL.name]}


_MEDIUM = Tray()

register_task("Tray-easy-v0", replace(_MEDIUM, leak=0.038, damping=0.3))
register_task("Tray-v0", _MEDIUM)
register_task("Tray-hard-v0", replace(_MEDIUM, damping=0.17))
