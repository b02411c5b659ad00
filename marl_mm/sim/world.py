"""The simulator as the rest of the package sees it, whichever engine computes it."""

import logging
from collections.abc import Mapping, Sequence
from functools import cache
from multiprocessing import parent_process
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from marl_mm.errors import UsageError
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.model import RobotState
from marl_mm.sim.config import (
    ENGINES,
    Camera,
    Engine,
    SimulationConfig,
    default_engine,
    is_installed,
)
from marl_mm.sim.scene import Mark, Scene

if TYPE_CHECKING:  # it loads the library of an engine
    from marl_mm.sim.mujoco.native import Native


class Touches(NamedTuple):
    """Contacts after a step."""

    fingers: int
    """Number of fingers that touch the block, 0 to 2."""

    stand: bool
    """Whether the block touches its stand."""

    ground: bool
    """Whether the block touches the ground."""

    collision: str
    """Forbidden collision in words; empty without one."""


class Handling(Protocol):
    """The gripper, and the block of a scene."""

    scene: Scene
    """Block and stand."""

    def close_gripper(self) -> None:
        """Close from now on, until something is there to squeeze."""

    def open_gripper(self) -> None:
        """Open from now on, and stay so."""

    def squeeze(self) -> None:
        """Press what is between the pads from now on, with the grip's force."""

    def weld(self) -> None:
        """Fix the block to the hand where it is now, and the fingers."""

    def unweld(self) -> None:
        """Release the block from the hand."""

    def opening(self) -> float:
        """Distance between the finger tips [m]."""

    def block_w(self) -> tuple[np.ndarray, np.ndarray]:
        """The block's centre, shape (3,) [m], and quaternion x, y, z, w."""

    def touches(self) -> Touches:
        """Contacts of the last step with a force above 0."""


class World(Protocol):
    """One robot on a plane."""

    def reset(self, marks: Sequence[Mark] = (), scene: Scene | None = None) -> None:
        """A new world: the robot at the origin, heading +x, in its start posture.

        Args:
            marks: Drawings without a body, for a world with visuals.
            scene: Block and stand. Without a scene, hand and arm are no solid bodies,
                which is faster.
        """

    def read(self) -> RobotState:
        """The robot's planar state, from the simulator's free-floating base.

        Raises:
            NonFiniteStateError: If the simulation has diverged.
            MarlMmError: If the engine warns of its state.
        """

    def attitude(self) -> tuple[float, float]:
        """Roll and pitch of the base [rad]; pitch is positive with the nose down."""

    def wheel_rates(self) -> tuple[float, float]:
        """Rates of the left and the right wheel [rad/s]."""

    def ground_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Contact points with the ground, shape (n, 3) [m], and normal forces [N].

        The forces, shape (n,), are those of the last step.
        """

    def command(self, forward: float, yaw_rate: float, torque: np.ndarray) -> None:
        """Set the motors for the next step.

        Args:
            forward: Base speed [m/s].
            yaw_rate: Base turning rate [rad/s].
            torque: Torques of the arm joints, shape (7,) [N m].
        """

    def step(self) -> None:
        """Advance by 1/240 s."""

    @property
    def native(self) -> "Native | None":
        """The world as compiled code sees it; None if only Python can step it."""

    @property
    def handling(self) -> Handling:
        """Gripper, block and stand of a world with a scene."""

    def grasp_position_w(self) -> np.ndarray:
        """Position of the end-effector in the simulation, shape (3,) [m]."""

    def move_marks(self, places: Mapping[int, Sequence[float]]) -> None:
        """Move drawings of a world with visuals.

        Args:
            places: Position of the centre [m], by the mark's number in ``reset``.
        """

    def render(self, camera: Camera) -> np.ndarray:
        """Image, shape (height, width, 3), uint8."""

    def close(self) -> None:
        """Free the engine's memory; closing twice is harmless."""


def open_world(
    robot: RobotConfig,
    config: SimulationConfig,
    visual: bool = False,
    gui: bool = False,
) -> World:
    """A world of the engine that the config names, which is imported here.

    Args:
        robot: Mass properties and start posture.
        config: Engine, settings of its solver and motors.
        visual: Load what ``render`` and the window show.
        gui: Open the engine's window.

    Raises:
        UsageError: If the engine is not installed or has no such pictures.
    """
    check_engine(config.engine)
    if config.engine == "mujoco":
        from marl_mm.sim.mujoco.world import MujocoWorld

        return MujocoWorld(robot, config, visual, gui)
    from marl_mm.sim.bullet.world import BulletWorld

    return BulletWorld(robot, config, visual, gui)


def check_engine(engine: Engine, advice: str = ", or choose another `engine`") -> None:
    """Raise for an engine that is not installed; log where MuJoCo stands in.

    The warning of the logger ``marl_mm`` comes once in a process, and not in workers.

    Args:
        engine: The engine.
        advice: End of the message: what else there is to do, if anything.

    Raises:
        UsageError: If the engine is not installed.
    """
    if not is_installed(engine):
        package, _ = ENGINES[engine]
        wheels = " (wheels: up to Python 3.11)" if engine == "bullet" else ""
        raise UsageError(
            f"engine {engine!r} needs the package {package}, which is not installed: "
            f"pip install {package}{wheels}{advice}"
        )
    stands_in = engine == "mujoco" and default_engine() == "mujoco"
    if stands_in and parent_process() is None:
        _say_fallback()


@cache
def _say_fallback() -> None:
    logging.getLogger("marl_mm").warning(
        "PyBullet is not installed (wheels: up to Python 3.11): MuJoCo simulates"
    )
