"""The base class of tasks: start, actions, observations, rewards and ends of episodes.

A task is a frozen dataclass of parameters with the functions below. It stores nothing
of an episode: an ``Attempt`` does. ``envs/tasks`` has one file per kind of task.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from marl_mm.control.config import ControllerConfig
from marl_mm.declared import ADDED, make_like_defaults
from marl_mm.envs.order import Order
from marl_mm.envs.terms import goal_distance
from marl_mm.episode import FAILED, GOAL_INFO, MOTION_INFO
from marl_mm.errors import UsageError
from marl_mm.layout import Layout
from marl_mm.robot.description import RobotConfig
from marl_mm.sim.config import RATE, Camera, SimulationConfig

if TYPE_CHECKING:  # a task's parameters load without the simulator
    from marl_mm.envs.drive import Drive, Motion, Tick, Watch

Values = Mapping[str, float]
"""Entries of a joint state or action, by name."""

Terms = Mapping[str, np.ndarray]
"""Numbers that rewards depend on beside the goal, by name; of one step or many."""


class Attempt:
    """One episode in progress.

    Args:
        task: The task of the episode.
        drives: The robots, as many as the task has.
    """

    def __init__(self, task: "Task", drives: "Sequence[Drive]") -> None:
        self.task = task
        self.drives = tuple(drives)
        self.steps = 0
        """Number of steps taken."""

        self.goal = np.empty(0)
        """Goal of the episode, shape (g,), in the units of its entries."""

        self.memory: Any = None
        """Object in which the task stores the episode's data."""

    def follow(
        self, orders: Sequence[Order], watch: "Watch | None" = None
    ) -> "list[Motion]":
        """Let every robot follow its order for a step's ticks.

        Args:
            orders: The order of each robot.
            watch: Function that is called after each robot's tick.
        """
        from marl_mm.envs.drive import follow

        task = self.task
        if type(task).at_tick is not Task.at_tick:
            watch = _both(self, watch)
        return follow(self.drives, orders, task.ticks_per_step, task.look_every, watch)


def _both(attempt: Attempt, watch: "Watch | None") -> "Watch":
    def see(tick: "Tick") -> None:
        attempt.task.at_tick(attempt, tick)
        if watch is not None:
            watch(tick)

    return see


@dataclass(frozen=True, kw_only=True)
class ScriptConfig:
    """Settings of a scripted expert."""

    alpha: float = 0.0
    """Alpha that the expert sets: 0 accurate hand ... 1 stable base."""

    convention: str = field(default="", metadata=ADDED)
    """Way of a task that has several, such as "over" or "under" of Bar; empty is the
    first."""

    kp: float = 10.0
    """Gain from distance to action [1/m]; 10 asks for the target within 0.1 m."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.alpha <= 1.0:
            raise UsageError(f"alpha is {self.alpha}, expected a number in [0, 1]")
        if not (np.isfinite(self.kp) and self.kp > 0):
            raise UsageError(f"kp is {self.kp}, expected > 0")


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """A kind of task with its parameters."""

    about: ClassVar[str] = ""
    """Sentence that says what there is to do."""

    layout: ClassVar[Layout]
    """Layout of the joint state and action."""

    robots: ClassVar[int] = 1
    """Number of robots, each in a world of its own."""

    needs: ClassVar[tuple[str, ...]] = ()
    """Names of the numbers that rewards depend on beside the goal: step numbers or
    entries of the state. ``"failed"`` is always among the terms."""

    own_info: ClassVar[Mapping[str, str]] = {}
    """Meanings, with units, of the step numbers that ``measure`` adds, by name."""

    handles: ClassVar[bool] = False
    """Whether robots have blocks, whose contacts are looked at within a step, too."""

    conventions: ClassVar[tuple[str, ...]] = ()
    """Names of the ways of the expert, where the agents have to agree on one."""

    hidden: ClassVar[Mapping[str, float]] = {}
    """Entries of the state that one agent alone sees and that decide, with values that
    tell nothing."""

    camera: ClassVar[Camera] = Camera()
    """Camera of pictures and films."""

    max_steps: int = 25
    """Number of steps until truncation (paper, Tables 2, 3)."""

    ticks_per_step: int = 240
    """Number of the controller's ticks per step: 240 Hz over 1 Hz (paper, Fig. 2)."""

    look_every: int = 8
    """Number of ticks between measurements of ZMP margin, tilt, slip, model error."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    """Mass properties and start posture of the robot."""

    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    """Solver and motors of the simulation."""

    controller: ControllerConfig = field(default_factory=ControllerConfig)
    """Form, gains and limits of the controller."""

    def __post_init__(self) -> None:
        make_like_defaults(self)
        for name in ("max_steps", "ticks_per_step", "look_every"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise UsageError(f"{name} is {value!r}, expected an integer >= 1")

    @property
    def seconds_per_step(self) -> float:
        """Duration of a step [s]."""
        return self.ticks_per_step / RATE

    @property
    def info(self) -> dict[str, str]:
        """Meanings, with units, of the step numbers that episodes keep, by name."""
        return {**self.own_info, **GOAL_INFO, **MOTION_INFO}

    @property
    def fails(self) -> bool:
        """Whether an episode can end in failure: the class has a ``failure``."""
        return type(self).failure is not Task.failure

    @property
    def highest_return(self) -> float | None:
        """Upper bound of all returns; None if the task has none."""
        return None

    # --- Start ---------------------------------------------------------------

    @abstractmethod
    def begin(
        self, attempt: Attempt, rng: np.random.Generator, goal: np.ndarray | None
    ) -> None:
        """Draw the random parts, reset the robots, and set ``attempt.goal``.

        Args:
            attempt: The new episode; the task may set its ``memory``.
            rng: Only source of randomness in the episode.
            goal: Goal to use instead of a drawn one, shape (g,).
        """

    def fixed_goal(
        self, index: int, rng: np.random.Generator
    ) -> tuple[float, ...] | None:
        """Goal of an evaluation's episode; None if its seed draws it.

        Args:
            index: Number of the episode in the evaluation.
            rng: Random stream of the evaluation's goals, which are drawn in order.
        """
        return None

    # --- Step ----------------------------------------------------------------

    @abstractmethod
    def act(self, attempt: Attempt, action: Values) -> Sequence[Order]:
        """The order to each robot that an action means.

        Args:
            attempt: The episode so far.
            action: Joint action by name, within its bounds.
        """

    def at_tick(self, attempt: Attempt, tick: "Tick") -> None:  # noqa: B027
        """See a tick of a robot; called only for tasks that override it.

        Ticks of unseen steps, before the episode's first observation, are among them.
        """

    def at_step(  # noqa: B027
        self, attempt: Attempt, motions: "Sequence[Motion]"
    ) -> None:
        """See a step's motion of each robot, tick by tick, before it is measured."""

    @abstractmethod
    def observe(self, attempt: Attempt) -> Values:
        """Joint state by name, without the goal."""

    def measure(self, attempt: Attempt) -> dict[str, Any]:
        """Step numbers of the task's own, by name, after a step."""
        return {}

    def failure(self, attempt: Attempt) -> str:
        """Reason of the episode's failure; empty without one."""
        return ""

    def moved_marks(self, attempt: Attempt) -> Sequence[Mapping[int, Sequence[float]]]:
        """Where marks are now that do not stay where they were, for pictures.

        Returns:
            For each robot the positions [m], by the mark's number in its world.
        """
        return ()

    # --- Reward --------------------------------------------------------------

    @abstractmethod
    def reached(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Whether goals count as reached, shapes (..., g) to (...).

        Args:
            achieved: Entries that are compared with the goal, after the steps.
            desired: Goals of the steps.
            terms: Numbers by name; see ``needs``.
        """

    @abstractmethod
    def reward(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """Rewards, shapes (..., g) to (...); see ``reached``."""

    def judge(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Terms
    ) -> tuple[np.ndarray, np.ndarray]:
        """Reward and termination of steps by these goals, shapes (n, g) to (n,)."""
        ended = self.reached(achieved, desired, terms) | terms[FAILED].astype(bool)
        return self.reward(achieved, desired, terms), ended

    def distance(self, achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
        """Distances of achieved entries to goals, shapes (..., g) to (...)."""
        return goal_distance(achieved, desired)

    # --- Expert --------------------------------------------------------------

    def check_script(self, script: ScriptConfig) -> None:
        """Raise for a convention that the task does not have.

        Raises:
            UsageError: If it is none of ``conventions``.
        """
        if script.convention and script.convention not in self.conventions:
            name = type(self).__name__
            choices = f"expected {' or '.join(self.conventions)}"
            expected = choices if self.conventions else f"and {name} has none"
            raise UsageError(f"convention is {script.convention!r}, {expected}")

    def expert(self, state: Values, script: ScriptConfig) -> Values:
        """Joint action by name of a scripted expert without memory.

        Args:
            state: Joint state by name.
            script: Settings of the expert.

        Raises:
            UsageError: If the task has no expert.
        """
        raise UsageError(f"{type(self).__name__} has no scripted expert")
