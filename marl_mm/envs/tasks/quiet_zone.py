"""QuietZone: bring the end-effector to a goal behind, and be quiet where it counts.

The hand's agent sees the goal, the balance agent the zones: stripes of the floor in
which the base has to be quiet. An episode fails at a tick at which the base is in a
zone and is told to accelerate by more than ``zone_limit``.

At alpha 0 the base keeps up with the hand and breaks every zone; at alpha 1 it is quiet
everywhere, and too late. So alpha has to rise before a zone and to fall behind it.
The script steers straight to the goal by steps of full length, and sets alpha to 1 from
15 cm before a zone to its end.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from marl_mm.declared import check_positive
from marl_mm.envs.cruise import ALPHA, BASE, DELTA, GOAL, HAND, MODE, Targets, names
from marl_mm.envs.hazard import HazardTask
from marl_mm.envs.intervals import Interval, check_intervals
from marl_mm.envs.registry import register_task
from marl_mm.envs.task import Attempt, ScriptConfig, Values
from marl_mm.envs.tasks.reach import steer, to_goal
from marl_mm.errors import UsageError
from marl_mm.layout import Agent, Entry, Layout
from marl_mm.sim.config import Camera
from marl_mm.sim.scene import YELLOW, Mark

if TYPE_CHECKING:
    from marl_mm.envs.drive import Motion

ZONES = tuple(
    Entry(f"zone_{number}_{end}", "m") for number in (1, 2) for end in ("near", "far")
)
"""Where the base enters and leaves each zone, x in the world; with one zone both are
the same."""

LAYOUT = Layout(
    (*HAND, *BASE, MODE, *ZONES, *GOAL),
    (*DELTA, ALPHA),
    (
        Agent("end_effector", names(*HAND, *BASE, *GOAL), names(*DELTA)),
        Agent("balance", names(*HAND, *BASE, MODE, *ZONES), names(ALPHA)),
    ),
    compared=names(*HAND),
    desired=names(*GOAL),
)
"""Layout of QuietZone: one agent sees the goal, the other one the zones."""

BRAKING = 0.15
"""Way in which a base at alpha 0 comes to rest at alpha 1: a step of each [m]."""

BEHIND = 0.4
"""Way beyond the goal's x that the base surely goes [m]: at the end of the script's
episodes it is 0.42 to 0.47 beyond."""


def felt_within(zones: np.ndarray, motion: "Motion") -> float:
    """Largest commanded acceleration of the base within zones [m/s^2]; 0 outside.

    Args:
        zones: Two ends of each zone, x in the world, shape (zones, 2) [m].
        motion: Motion of the robot in a step.
    """
    x = motion.q[:, :1]
    inside = ((x < zones.max(axis=1)) & (x > zones.min(axis=1))).any(axis=1)
    return float(np.abs(motion.base_acceleration[inside]).max(initial=0.0))


@dataclass(frozen=True, kw_only=True)
class QuietZone(HazardTask):
    """The task, with goals, zones and reward as fields."""

    about = "Reach a goal behind, with a base that is quiet within zones."
    layout = LAYOUT
    hidden = dict.fromkeys(names(*ZONES), 9.0)
    camera = Camera(target_w=(-0.4, 0.0, 0.3), distance=2.7, pitch=-28.0)
    own_info: ClassVar[dict[str, str]] = {
        **HazardTask.own_info,
        "zone_acceleration": "largest acceleration of the base within a zone [m/s^2]",
    }

    max_steps: int = 26
    """Number of steps until truncation: too few for a base that is always quiet."""

    goal_x: Interval = (-0.9, -0.8)
    """Interval of x of goals, world [m]."""

    zones: int = 1
    """Number of zones, 1 or 2."""

    zone_x: Interval = (-0.75, -0.25)
    """Interval of x in which the zones lie, of the base, world [m]."""

    zone_length: Interval = (0.1, 0.2)
    """Interval of the length of each zone [m]."""

    zone_limit: float = 0.15
    """Largest commanded acceleration of the base within a zone [m/s^2]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_intervals(self, "zone_x")
        check_positive(self, "zone_length", "zone_limit")
        if self.zones not in (1, 2):
            raise UsageError(f"zones is {self.zones}, expected 1 or 2")
        (far, near), longest = self.zone_x, self.zone_length[1]
        end = self.goal_x[1] - BEHIND
        if not -BRAKING >= near >= far >= end:
            raise UsageError(
                f"zone_x is {far:g} to {near:g}, expected within {end:g} to "
                f"{-BRAKING:g} m: behind the base's start, before its end at the goal"
            )
        if self.zones * (longest + BRAKING) > near - far + BRAKING:
            raise UsageError(
                f"{self.zones} zones of {longest:g} m do not fit into zone_x, {far:g} "
                f"to {near:g} m, with {BRAKING:g} m between them"
            )

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Ends of the zones, near and far, shape (zones, 2), nearest first [m]."""
        far, near = self.zone_x
        room = (near - far + BRAKING) / self.zones - BRAKING
        drawn = []
        for number in range(self.zones):
            length = rng.uniform(*self.zone_length)
            start = (
                near
                - number * (room + BRAKING)
                - rng.uniform(0.0, max(room - length, 0.0))
            )
            drawn.append((start, start - length))
        return np.array(drawn)

    def marks(self, hazard: np.ndarray) -> list[Mark]:
        """The zones on the floor."""
        return [
            Mark(((near + far) / 2, 0.0, 0.002), (near - far, 1.6, 0.004), YELLOW)
            for near, far in hazard.tolist()
        ]

    def observe(self, attempt: Attempt) -> Values:
        """Joint state of hand and base, and the zones."""
        ends = np.resize(attempt.memory.drawn, len(ZONES)).tolist()
        return {
            **super().observe(attempt),
            **dict(zip(names(*ZONES), ends, strict=True)),
        }

    def harm(self, targets: Targets, motion: "Motion") -> tuple[str, dict[str, float]]:
        """A base that accelerates too much within a zone."""
        felt = felt_within(targets.drawn, motion)
        reason = "the base was not quiet in a zone" if felt > self.zone_limit else ""
        return reason, {"zone_acceleration": felt}

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        """Steer straight to the goal; alpha is 1 where the base has to be quiet."""
        ends = np.array([state[entry.name] for entry in ZONES]).reshape(-1, 2)
        x = state["base_x"]
        quiet = ((x < ends[:, 0] + BRAKING) & (x > ends[:, 1])).any()
        return steer(script.kp * to_goal(state)) | {
            ALPHA.name: 1.0 if quiet else script.alpha
        }


_MEDIUM = QuietZone()

register_task(
    "QuietZone-easy-v0",
    replace(_MEDIUM, zone_length=(0.08, 0.12), zone_limit=0.2, max_steps=25),
)
register_task("QuietZone-v0", _MEDIUM)
register_task(
    "QuietZone-hard-v0",
    replace(_MEDIUM, zones=2, zone_length=(0.08, 0.15), zone_limit=0.1, max_steps=28),
)
register_task("QuietZone-halves-v0", replace(_MEDIUM, halves=True))
