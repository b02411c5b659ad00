"""The random tests of the paper's Fig. 3: one half of the robot moves, the other rests.

In (a) the arm reaches a point while the base stands. In (b) the base turns to an angle
while the arm rests.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from marl_mm.control.config import ControllerConfig, Gains
from marl_mm.control.priorities import LEFT_OUT, STABILITY, cumulative
from marl_mm.control.records import Priorities, Reference
from marl_mm.envs.drive import Drive, Tick, Watch
from marl_mm.envs.terms import length
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.model import RobotState
from marl_mm.sim.config import RATE, SimulationConfig

BASE_THEN_POSTURE = cumulative((1, 1, LEFT_OUT, LEFT_OUT, 2))
"""Priorities without the hand's tasks, which would hold back the base's turn."""


DEMOS = ("arm-reach", "base-turn")
"""Names of the demos."""


class Drift(NamedTuple):
    """Errors at the end, and the largest motion of the parts that should rest.

    A number is None if its part has no target, or is not meant to rest.
    """

    position_error: float | None
    """Distance of the end-effector to its target at the end [m]."""

    heading_error: float | None
    """Angle of the heading to its target at the end [rad]."""

    base_drift: float
    """Largest distance of the base's origin from its start [m]."""

    heading_drift: float | None
    """Largest angle of the heading from its start [rad]."""

    arm_drift: float | None
    """Largest angle of any joint from its start [rad]."""


def arm_reach(
    drive: Drive, target_w: np.ndarray, seconds: float, watch: Watch | None = None
) -> Drift:
    """The arm reaches a point while the base stands still.

    Args:
        drive: The robot, which is reset.
        target_w: Target of the end-effector, world frame, shape (3,) [m].
        seconds: Duration [s].
        watch: Function that is called after each tick.
    """
    start, rest = _start(drive)
    reference = rest._replace(ee_position_w=np.asarray(target_w, dtype=float))
    states = _follow(drive, STABILITY, lambda k, state: reference, seconds, watch)
    error = drive.world.grasp_position_w() - reference.ee_position_w
    drift = _drift(start, states)
    return drift._replace(position_error=float(length(error)), arm_drift=None)


def base_turn(
    drive: Drive, angle: float, seconds: float, watch: Watch | None = None
) -> Drift:
    """The base turns on the spot while the arm rests.

    Args:
        drive: The robot, which is reset.
        angle: Target of the heading [rad], within half a turn.
        seconds: Duration [s].
        watch: Function that is called after each tick.
    """
    start, rest = _start(drive)
    reference = rest._replace(base_heading=float(angle))
    states = _follow(
        drive, BASE_THEN_POSTURE, lambda k, state: reference, seconds, watch
    )
    error = drive.state.yaw - angle
    error = float(np.abs(np.arctan2(np.sin(error), np.cos(error))))
    return _drift(start, states)._replace(heading_error=error, heading_drift=None)


def demo_drive(visual: bool = False, gui: bool = False) -> Drive:
    """A robot whose controller holds the arm's posture tightly."""
    controller = ControllerConfig(gains=Gains(posture_rate=12.0))
    return Drive(RobotConfig(), SimulationConfig(), controller, visual, gui)


def _start(drive: Drive) -> tuple[RobotState, Reference]:
    """The state in a new world, and the reference that holds the robot there."""
    start = drive.reset()
    terms = drive.model.evaluate(start)
    return start, Reference(
        terms.position_w.copy(),
        np.ascontiguousarray(terms.rotation_w).copy(),
        start.q[:2].copy(),
        start.yaw,
        0.0,
        start.q[4:].copy(),
    )


def _follow(
    drive: Drive,
    levels: np.ndarray,
    reference_at: Callable[[int, RobotState], Reference],
    seconds: float,
    watch: Watch | None,
) -> list[RobotState]:
    states: list[RobotState] = []

    def see(tick: Tick) -> None:
        states.append(tick.state)
        if watch is not None:
            watch(tick)

    priorities = Priorities(levels[None], np.ones(1))
    drive.follow(reference_at, priorities, round(seconds * RATE), 8, see)
    return [*states, drive.state]


def _drift(start: RobotState, states: list[RobotState]) -> Drift:
    q = np.array([state.q for state in states]) - start.q
    yaw = np.array([state.yaw for state in states]) - start.yaw
    return Drift(
        None,
        None,
        float(np.linalg.norm(q[:, :2], axis=1).max()),
        float(np.abs(np.arctan2(np.sin(yaw), np.cos(yaw))).max()),
        float(np.abs(q[:, 4:]).max()),
    )
