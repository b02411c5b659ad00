"""The closed loop: robots under their controllers follow references for some ticks.

Simulator, model and controller meet only here. Stability is measured every few ticks;
a ``Watch`` sees every tick, at 240 Hz.
"""

from collections.abc import Callable, Sequence
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np

from marl_mm.control.config import ControllerConfig, Knowledge
from marl_mm.control.limits import WHEEL_ARM
from marl_mm.control.records import Command, Priorities, ReferenceAt
from marl_mm.control.wbc import WholeBodyController
from marl_mm.envs.hand import Hand
from marl_mm.envs.order import Order
from marl_mm.errors import UsageError
from marl_mm.robot.description import WHEEL_RADIUS, RobotConfig
from marl_mm.robot.limits import robot_limits
from marl_mm.robot.model import ModelTerms, RobotModel, RobotState
from marl_mm.robot.planar import PlanarModel
from marl_mm.robot.support import support_margin
from marl_mm.sim.config import RATE, SimulationConfig
from marl_mm.sim.scene import Mark, Scene
from marl_mm.sim.world import open_world


class Tick(NamedTuple):
    """One tick of one robot, for a ``Watch``."""

    number: int
    """Number of the tick within its step."""

    state: RobotState
    """State before the tick."""

    command: Command
    """Command during the tick."""

    terms: ModelTerms
    """Terms of the model at the state, valid until the robot's next tick."""

    after: RobotState
    """State after the tick."""

    robot: int
    """Number of the robot."""


Watch = Callable[[Tick], None]
"""Function that is called after each robot's tick."""


class Motion(NamedTuple):
    """Measurements over some ticks; extremes are of every few of them."""

    base_acceleration: np.ndarray
    """Commanded forward acceleration of the base, shape (ticks,) [m/s^2]."""

    q: np.ndarray
    """Configuration before each tick, as in ``RobotState``, shape (ticks, 11)."""

    hand_w: np.ndarray
    """Position of the model's end-effector before each tick, shape (ticks, 3) [m]."""

    zmp_margin: float
    """Least distance of the zero-moment point to the support polygon's edge [m]."""

    tilt: float
    """Largest angle of the base's vertical axis to the world's [rad]."""

    base_pitch: float
    """Largest pitch of the base, which the controller's planar model lacks [rad]."""

    wheel_slip: float
    """Largest speed between a drive wheel's rim and the ground along it [m/s]."""

    model_ee_error: float
    """Largest distance of the model's end-effector to the simulator's [m]."""

    qp_failures: int
    """Number of levels of the hierarchy that found no solution."""

    safe_ticks: int
    """Number of ticks in which no acceleration met all limits: it only braked."""


class Drive:
    """One robot in a world of its own, and its controller.

    Args:
        robot: Mass properties and start posture.
        simulation: Solver and motors of the simulation.
        controller: Form, gains and limits of the controller.
        visual: Whether to load meshes for rendering.
        gui: Whether to open PyBullet's window.
    """

    def __init__(
        self,
        robot: RobotConfig,
        simulation: SimulationConfig,
        controller: ControllerConfig,
        visual: bool = False,
        gui: bool = False,
    ) -> None:
        self.limits = robot_limits(robot)
        self.world = open_world(robot, simulation, visual, gui)
        # Pinocchio's last bits are those of version 1.
        self.model = (
            PlanarModel(robot)
            if self.world.native
            else RobotModel(robot, balance=controller.limits.zmp)
        )
        self.controller = WholeBodyController(self.limits, controller, RATE)
        self._posture = robot.initial_joints
        self._scene: Scene | None = None
        self._check_balance(controller)
        self.state = self._rest()
        """The robot's state now."""

        self.hand: Hand | None = None
        """The hand that holds a block; None if there is no block."""

    def reset(
        self, marks: Sequence[Mark] = (), scene: Scene | None = None
    ) -> RobotState:
        """A new world, with the robot at rest in its start posture.

        Args:
            marks: Marks that are only seen.
            scene: Things to handle.
        """
        self.world.reset(marks, scene)
        self.state = self.world.read()
        if self.hand is not None:
            self.hand.payload.release()
        self.hand, self._scene = None, scene
        return self.state

    def start_w(self) -> np.ndarray:
        """Position of the end-effector in the start posture, shape (3,) [m]."""
        return self.model.evaluate(self._rest()).position_w.copy()

    def _rest(self) -> RobotState:
        return RobotState(np.array([0, 0, 1, 0, *self._posture]), np.zeros(10))

    def _check_balance(self, controller: ControllerConfig) -> None:
        """Refuse a robot that cannot stand in its start posture."""
        rest = self._rest()
        self.model.evaluate(rest)
        margin = support_margin(self.model.zmp_b(rest, np.zeros(9)))
        least = controller.limits.zmp_margin if controller.limits.zmp else 0.0
        if margin <= least:
            self.world.close()
            raise UsageError(
                f"in its start posture the robot's weight is {margin:.3f} m inside the "
                f"edge of its wheels' support, expected > {least:g}: see "
                "robot.base_com_b, robot.initial_joints, controller.limits.zmp_margin"
            )

    def handle(self, scene: Scene, knowledge: Knowledge) -> Hand:
        """Give the robot a hand for the block in the scene.

        Args:
            scene: The scene of ``reset``.
            knowledge: Source of the load's mass for the controller.

        Raises:
            UsageError: If ``reset`` had another, or none.
        """
        if scene is not self._scene:
            raise UsageError("handle() has another scene than reset(), or reset() none")
        self.hand = Hand(self.world.handling, self.model, scene, knowledge)
        return self.hand

    def follow(
        self,
        reference_at: ReferenceAt,
        priorities: Priorities,
        ticks: int,
        every: int,
        watch: Watch | None = None,
    ) -> Motion:
        """Run the controller for some ticks; ``state`` is the robot after them.

        Args:
            reference_at: Reference of the controller's tasks at a tick and state.
            priorities: Priorities of the controller's tasks.
            ticks: Number of ticks of 1/240 s.
            every: Number of ticks between measurements of stability.
            watch: Function that is called after each tick.
        """
        (motion,) = follow(
            [self], [Order(reference_at, priorities)], ticks, every, watch
        )
        return motion

    def zmp_b(self, state: RobotState, command: Command) -> np.ndarray:
        """Zero-moment point on the ground in the base frame, shape (2,) [m].

        It counts the load's true mass, whatever the controller knows of it.

        Args:
            state: State of the robot.
            command: Command at this state.
        """
        if self.hand is None:
            return self.model.zmp_b(state, command.acceleration)
        with self.hand.payload.revealed():
            return self.model.zmp_b(state, command.acceleration)

    def close(self) -> None:
        """Disconnect from the simulator."""
        self.world.close()

    def look(
        self, state: RobotState, position_w: np.ndarray, command: Command
    ) -> tuple[float, float, float, float, float]:
        """Margin [m], tilt, pitch [rad], slip [m/s], model's error [m]: see Motion."""
        x, y, z = position_w.tolist()
        ee_x, ee_y, ee_z = self.world.grasp_position_w()
        error = sqrt((x - ee_x) ** 2 + (y - ee_y) ** 2 + (z - ee_z) ** 2)
        roll, pitch = self.world.attitude()
        slip = wheel_slip(state, self.world.wheel_rates())
        margin = support_margin(self.zmp_b(state, command))
        return margin, hypot(roll, pitch), pitch, slip, error


def follow(
    drives: Sequence[Drive],
    orders: Sequence[Order],
    ticks: int,
    every: int,
    watch: Watch | None = None,
) -> list[Motion]:
    """Run robots side by side, tick by tick, and return the motion of each.

    Args:
        drives: The robots.
        orders: The order of each robot.
        ticks: Number of ticks of 1/240 s.
        every: Number of ticks between measurements of stability.
        watch: Function that is called after each robot's tick.
    """
    pairs = list(zip(drives, orders, strict=True))
    if watch is None and all(drive.world.native for drive in drives):
        from marl_mm.envs import compiled  # needs the library of such an engine

        if all(compiled.can_follow(*pair) for pair in pairs):
            return [compiled.follow(*pair, ticks, every) for pair in pairs]
    steps = [_Step(*pair, ticks, every) for pair in pairs]
    for k in range(ticks):
        for number, step in enumerate(steps):
            step.tick(k, number, watch)
    return [step.motion() for step in steps]


class _Step:
    """One robot's step, tick by tick."""

    def __init__(self, drive: Drive, order: Order, ticks: int, every: int) -> None:
        self._drive, self._every = drive, every
        self._command_at = drive.controller.along(*order)
        self._accelerations = np.empty(ticks)
        self._q, self._hand_w = np.empty((ticks, 11)), np.empty((ticks, 3))
        self._looks: list[tuple[float, float, float, float, float]] = []
        self._failures = self._safe = 0

    def tick(self, k: int, number: int, watch: Watch | None) -> None:
        """One tick: model, controller, simulator, hand, in that order."""
        drive = self._drive
        state, world = drive.state, drive.world
        terms = drive.model.evaluate(state)
        command = self._command_at(k, state, terms)
        if k % self._every == 0:
            self._looks.append(drive.look(state, terms.position_w, command))
        self._accelerations[k] = command.acceleration[0]
        self._q[k], self._hand_w[k] = state.q, terms.position_w
        world.command(*command.base_speed, command.torque)
        world.step()
        if command.failures:
            self._failures += command.failures
            self._safe += command.safe
        after = drive.state = world.read()
        if drive.hand is not None:
            drive.hand.feel(state, terms, command.torque, after)
        if watch is not None:
            watch(Tick(k, state, command, terms, after, number))

    def motion(self) -> Motion:
        margins, tilts, pitches, slips, errors = zip(*self._looks, strict=True)
        return Motion(
            self._accelerations,
            self._q,
            self._hand_w,
            min(margins),
            max(tilts),
            max(pitches, key=abs),
            max(slips),
            max(errors),
            self._failures,
            self._safe,
        )


def wheel_slip(state: RobotState, rates: tuple[float, float]) -> float:
    """Larger speed of the two rims over the ground, along the wheels [m/s].

    Args:
        state: State of the robot.
        rates: Speeds of the left and the right wheel [rad/s].
    """
    left, right = rates
    forward, turn = state.v[0].item(), WHEEL_ARM * state.v[2].item()
    slip_left = abs(WHEEL_RADIUS * left - forward + turn)
    slip_right = abs(WHEEL_RADIUS * right - forward - turn)
    slip: float = max(slip_left, slip_right)
    return slip
