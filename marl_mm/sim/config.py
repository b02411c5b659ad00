"""Settings of simulation and camera; independent of the engine."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from marl_mm.errors import UsageError

RATE = 240
"""Simulation steps and controller ticks per second (paper, Sec. 4.1)."""


Engine = Literal["bullet", "mujoco"]

ENGINES: dict[Engine, tuple[str, str]] = {
    "bullet": ("pybullet", "pybullet"),
    "mujoco": ("mujoco-core", "mujoco"),
}
"""Package, and module in it, of each engine."""


DEFAULT_ENGINE: Engine = "bullet"
"""Engine of the tasks, unless another is asked for; that of version 1."""


def engine_of(overrides: Mapping[str, Any]) -> Engine:
    """Engine of a task with these fields replaced.

    Raises:
        UsageError: If the fields are of another kind.
    """
    simulation = overrides.get("simulation", {})
    if not isinstance(simulation, Mapping):
        raise UsageError(f"simulation is {simulation!r:.60}, expected a mapping")
    engine: Engine = simulation.get("engine", DEFAULT_ENGINE)
    return engine


def engine_overrides(engine: Engine | None) -> dict[str, Any]:
    """Replaced fields of a task on this engine; none for the default one."""
    if engine in (None, DEFAULT_ENGINE):
        return {}
    return {"simulation": {"engine": engine}}


@dataclass(frozen=True)
class SimulationConfig:
    """Engine, and settings of its solver, motors and contacts."""

    engine: Engine = DEFAULT_ENGINE
    """Engine of the simulation: "bullet" or "mujoco"; the paper has PyBullet."""

    solver_iterations: int = 20
    """Iterations of the contact solver; 10, 20 and 50 agree to 0.1 mm."""

    wheel_force: float = 40.0
    """Largest torque of a wheel's velocity motor [N m]; ours: far below the 200 N m of
    the drive, enough for 2 m/s^2."""

    wheel_friction: float = 1.0
    """Friction coefficient between drive wheels and ground."""

    finger_force: float = 20.0
    """Largest force of a finger's position motor, which holds an empty gripper [N]."""

    grasp_iterations: int = 50
    """Iterations of the contact solver where friction holds a block: 3 kg, shaken for
    12 s at a friction coefficient of 0.6, creep by 0.2 mm; with 30 by 1 mm."""

    grip_force: float = 70.0
    """Grip force of each finger [N] (Franka Hand data sheet: continuous)."""

    grip_speed: float = 0.05
    """Closing speed of each finger [m/s] (Franka Hand data sheet)."""

    spinning_friction: float = 0.002
    """Spinning friction of pads and blocks about the normal [m]: pads are patches."""

    def __post_init__(self) -> None:
        if self.engine not in ENGINES:
            raise UsageError(
                f"simulation.engine is {self.engine!r}, expected {' or '.join(ENGINES)}"
            )


@dataclass(frozen=True)
class Camera:
    """A fixed camera that looks at the robot's work space."""

    width: int = 480
    """Width of the image [pixels]; a multiple of 16 suits video codecs."""

    height: int = 320
    """Height of the image [pixels]."""

    target_w: tuple[float, float, float] = (0.05, 0.0, 0.40)
    """Point at the centre of the image [m]."""

    distance: float = 2.6
    """Distance from the target [m]."""

    yaw: float = 15.0
    """Yaw of the view [deg]."""

    pitch: float = -18.0
    """Pitch of the view [deg]."""

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            size = getattr(self, name)
            if not 16 <= size <= 4096 or size % 2:
                raise UsageError(f"camera {name} is {size}, expected even, 16 to 4096")
        angles = (self.yaw, self.pitch, *self.target_w)
        if not (np.isfinite(angles).all() and 0 < self.distance < 100):
            raise UsageError("camera angles and distance must be finite, distance > 0")
