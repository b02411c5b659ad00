"""Settings of simulation and camera; independent of the engine."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, Literal

from marl_mm.declared import check_not_negative, check_positive, make_like_defaults
from marl_mm.errors import UsageError

RATE = 240
"""Simulation steps and controller ticks per second (paper, Sec. 4.1)."""


Engine = Literal["bullet", "mujoco"]

ENGINES: dict[Engine, tuple[str, str]] = {
    "bullet": ("pybullet", "pybullet"),
    "mujoco": ("mujoco-core", "mujoco"),
}
"""Package, and module in it, of each engine."""


RECORDED_ENGINE: Engine = "bullet"
"""Engine of records that name none, as those of version 1, on every Python."""


def is_installed(engine: Engine) -> bool:
    """Whether an engine's package is there."""
    _, module = ENGINES[engine]
    return find_spec(module) is not None


def default_engine() -> Engine:
    """Engine of the tasks where none is asked for: PyBullet; without it, MuJoCo."""
    return "bullet" if is_installed("bullet") else "mujoco"


def engine_of(overrides: Mapping[str, Any]) -> Engine:
    """Engine of a record of a task with these fields replaced.

    Raises:
        UsageError: If the fields are of another kind.
    """
    simulation = overrides.get("simulation", {})
    if not isinstance(simulation, Mapping):
        raise UsageError(f"simulation is {simulation!r:.60}, expected a mapping")
    engine: Engine = simulation.get("engine", RECORDED_ENGINE)
    return engine


def engine_overrides(engine: Engine | None) -> dict[str, Any]:
    """Replaced fields of a task on an engine; None is the default one.

    Empty where it is the default engine and the one that records leave out.
    """
    engine = engine or default_engine()
    if engine == RECORDED_ENGINE == default_engine():
        return {}
    return {"simulation": {"engine": engine}}


def as_recorded(overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Replaced fields that name the engine of a record, for a task to be on it."""
    return _on(RECORDED_ENGINE, overrides)


def to_record(overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Replaced fields for a record: they name the engine, but the recorded one."""
    default = default_engine()
    return dict(overrides) if default == RECORDED_ENGINE else _on(default, overrides)


def _on(engine: Engine, overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Replaced fields that name this engine if they name none."""
    simulation = {"engine": engine, **overrides.get("simulation", {})}
    return {**overrides, "simulation": simulation}


@dataclass(frozen=True)
class SimulationConfig:
    """Engine, and settings of its solver, motors and contacts."""

    engine: Engine = field(default_factory=default_engine)
    """Engine of the simulation: "bullet" or "mujoco"; the paper has PyBullet. Default
    bullet, or mujoco where PyBullet is not installed."""

    solver_iterations: int = 20
    """Iterations of PyBullet's contact solver, not MuJoCo's. 20 leave the base up to
    5 mm from where 50 or 200 bring it, and motors of a base of over 100 kg need 50."""

    wheel_force: float = 40.0
    """Largest torque of a wheel's velocity motor [N m]; ours: far below the 200 N m of
    the drive, enough for 2 m/s^2."""

    wheel_friction: float = 1.0
    """Friction coefficient between drive wheels and ground."""

    finger_force: float = 20.0
    """Largest force of a finger's position motor, which holds an empty gripper [N];
    PyBullet's, as MuJoCo's is as strong as it has to be."""

    grasp_iterations: int = 50
    """Iterations of PyBullet's contact solver, and not MuJoCo's, where friction holds a
    block: 3 kg, shaken for 12 s at a friction coefficient of 0.6, creep by 0.2 mm; with
    30 by 1 mm."""

    grip_force: float = 70.0
    """Grip force of each finger [N] (Franka Hand data sheet: continuous)."""

    grip_speed: float = 0.05
    """Closing speed of each finger [m/s] (Franka Hand data sheet)."""

    spinning_friction: float = 0.002
    """Spinning friction of pads and blocks about the normal [m]: pads are patches.
    PyBullet, which combines both sides', has 1.6 to 2 times as much."""

    def __post_init__(self) -> None:
        make_like_defaults(self, "simulation.")
        if self.engine not in ENGINES:
            raise UsageError(
                f"simulation.engine is {self.engine!r}, expected {' or '.join(ENGINES)}"
            )
        numbers = ("solver_iterations", "wheel_force", "wheel_friction")
        blocks = ("finger_force", "grasp_iterations", "grip_force", "grip_speed")
        check_positive(self, *numbers, *blocks, of="simulation.")
        check_not_negative(self, "spinning_friction", of="simulation.")


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
        make_like_defaults(self, "camera ")
        for name in ("width", "height"):
            size = getattr(self, name)
            if not 16 <= size <= 4096 or size % 2:
                raise UsageError(f"camera {name} is {size}, expected even, 16 to 4096")
        if not 0 < self.distance < 100:
            raise UsageError(
                f"camera distance is {self.distance} m, expected above 0, below 100"
            )
