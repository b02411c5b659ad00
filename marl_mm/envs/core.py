"""One episode: the shared core of the Gymnasium and the PettingZoo environment.

A step lasts one second: the task turns the action into an order for each robot, which
its whole-body controller follows for 240 ticks. The task defines actions, observations
and rewards.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from marl_mm.envs.arguments import checked_goal, refuse_copies
from marl_mm.envs.drive import Drive, Motion, Watch
from marl_mm.envs.order import Order
from marl_mm.envs.task import Attempt, Task
from marl_mm.episode import FAILED
from marl_mm.errors import (
    InvalidActionError,
    LayoutError,
    MarlMmError,
    UsageError,
)
from marl_mm.sim.config import RATE, Camera


class Step(NamedTuple):
    """Result of a step."""

    state: np.ndarray
    """Joint state after the step, shape (n,), as in the task's layout."""

    reward: float
    """Reward that the agents share."""

    terminated: bool
    """Whether the step reached the goal or failed."""

    truncated: bool
    """Whether the episode is out of steps."""

    info: dict[str, Any]
    """Step numbers by name, whose units are in ``Task.info``. Tasks that can fail add
    ``reason``, a text."""


class EpisodeCore:
    """The robots, their controllers and the task.

    Args:
        task: The task.
        visual: Whether to load meshes for rendering.
        gui: Whether to open PyBullet's window, for the first robot.
    """

    def __init__(self, task: Task, visual: bool = False, gui: bool = False) -> None:
        self.task = task
        self.drives = tuple(
            Drive(task.robot, task.simulation, task.controller, visual, gui and not i)
            for i in range(task.robots)
        )
        self.attempt: Attempt | None = None
        """The current episode; None before the first, and after an error in a step."""

        self._visual, self._closed = visual or gui, False
        self._low, self._high = np.array(task.layout.low), np.array(task.layout.high)

    __reduce__ = refuse_copies

    @property
    def drive(self) -> Drive:
        """The first robot."""
        return self.drives[0]

    def reset(
        self, rng: np.random.Generator, goal: np.ndarray | None = None
    ) -> np.ndarray:
        """Begin an episode and return the joint state.

        Args:
            rng: Only source of randomness in the episode.
            goal: Goal to use instead of a drawn one, shape (g,), in the units of the
                layout's entries.

        Raises:
            UsageError: If the goal has another shape, is not finite or beyond the
                bounds of its entries, or after ``close()``.
            LayoutError: If the task sets or observes other entries than its layout has.
        """
        self.check_open()
        given = None if goal is None else checked_goal(goal, self.task.layout)
        attempt = Attempt(self.task, self.drives)
        self.attempt = None  # where the task refuses, there is no episode to go on with
        self.task.begin(attempt, rng, given)
        state = self._state(attempt)
        self.attempt = attempt
        return state

    def step(self, action: np.ndarray, watch: Watch | None = None) -> Step:
        """Act for one step.

        Args:
            action: Joint action, shape (k,), as in the task's layout; it is clipped to
                the bounds.
            watch: Function that is called after each tick.

        Raises:
            InvalidActionError: If the action has another shape or is not finite.
            UsageError: If there was no ``reset()``, or none since a step that raised
                another error; or after ``close()``.
            NonFiniteStateError: If the simulation diverged.
            LayoutError: If the task observes or measures other entries than it should.
            MarlMmError: If the engine warned, or a number of the task is not finite.
        """
        return self.push(self.bounded(action), watch)

    def bounded(self, action: np.ndarray) -> np.ndarray:
        """The action that ``step`` carries out: within the bounds, float64.

        Raises:
            InvalidActionError: If the action has another shape or is not finite.
        """
        bounded: np.ndarray = np.clip(self._checked(action), self._low, self._high)
        return bounded

    def push(self, action: np.ndarray, watch: Watch | None = None) -> Step:
        """``step`` without checks and bounds, for actions beyond the action space."""
        attempt, task = self._begun(), self.task
        named = dict(zip(task.layout.action_names, action.tolist(), strict=True))
        try:
            motions = attempt.follow(self._ordered(task.act(attempt, named)), watch)
            attempt.steps += 1
            task.at_step(attempt, motions)
            return self._judged(attempt, motion_info(motions))
        except BaseException:  # an episode that breaks off within a step cannot go on
            self.attempt = None
            raise

    def render(self, camera: Camera) -> np.ndarray:
        """A picture of every robot's world, side by side, shape (h, w, 3), uint8.

        Raises:
            UsageError: If there was no ``reset()``, after ``close()``, or if there are
                no visuals.
        """
        moved = self.task.moved_marks(self._begun("render"))
        if not self._visual:
            raise UsageError("render() needs EpisodeCore(task, visual=True)")
        for drive, marks in zip(self.drives, moved, strict=False):
            drive.world.move_marks(marks)
        return np.hstack([drive.world.render(camera) for drive in self.drives])

    def starts(self) -> np.ndarray:
        """Configurations of the robots now, shape (11 R,).

        Raises:
            UsageError: If there was no ``reset()``, or after ``close()``.
        """
        self._begun("starts")
        return np.concatenate([drive.state.q for drive in self.drives])

    def check_open(self) -> None:
        """Raise if the environment was closed.

        Raises:
            UsageError: If it was.
        """
        if self._closed:
            raise UsageError("the environment is closed: make another")

    def close(self) -> None:
        """Disconnect from the simulators; closing twice is harmless."""
        self._closed = True
        for drive in self.drives:
            drive.close()

    def _begun(self, what: str = "step") -> Attempt:
        self.check_open()
        if self.attempt is None:
            raise UsageError(
                f"{what}() was called before reset(), or after a step that raised"
            )
        return self.attempt

    def _ordered(self, orders: Any) -> Sequence[Order]:
        """What the task's ``act`` returned."""
        right = isinstance(orders, Sequence) and len(orders) == len(self.drives)
        if not right or not all(isinstance(order, Order) for order in orders):
            raise UsageError(
                f"{self._name}.act returned {orders!r:.60}, expected a list "
                f"with an Order for each of {len(self.drives)} robots"
            )
        return cast(Sequence[Order], orders)

    def _judged(self, attempt: Attempt, moved: dict[str, Any]) -> Step:
        """The step's result; ``moved`` has the numbers of ``MOTION_INFO``."""
        task, layout = self.task, self.task.layout
        measured, reason = self._measured(attempt)
        state = self._state(attempt)
        info = self._with_needs(measured | moved, state)
        terms = {name: np.asarray(info[name]) for name in task.needs}
        terms[FAILED] = np.asarray(bool(reason))
        achieved, goal = state[layout.achieved], attempt.goal
        reached = self._number("reached", task.reached(achieved, goal, terms))
        success = bool(reached) and not reason
        distance = self._number("distance", task.distance(achieved, goal))
        info |= {"distance": distance, "is_success": success}
        if task.fails:
            info["reason"] = reason
        info = {name: info[name] for name in task.info} | info  # declared ones first
        reward = self._number("reward", task.reward(achieved, goal, terms))
        ended = success or bool(reason)
        truncated = attempt.steps >= task.max_steps and not ended
        return Step(state, reward, ended, truncated, info)

    def _measured(self, attempt: Attempt) -> tuple[dict[str, Any], str]:
        """The task's step numbers, and the reason of a failure, empty without one."""
        measured, reason = self.task.measure(attempt), self.task.failure(attempt)
        if not isinstance(measured, Mapping):
            raise LayoutError(
                f"{self._name}.measure is {measured!r:.60}, expected a dict"
            )
        if not isinstance(reason, str):
            raise LayoutError(
                f"{self._name}.failure is {reason!r:.60}, expected words, or '' if "
                "there is none"
            )
        return dict(measured), reason

    def _with_needs(self, info: dict[str, Any], state: np.ndarray) -> dict[str, Any]:
        """Step numbers with the state's entries that rewards depend on."""
        names = self.task.layout.state_names
        known = dict(zip(names, state.tolist(), strict=True)) | info
        if unknown := set(self.task.needs) - known.keys():
            raise LayoutError(
                f"{self._name}.needs has {', '.join(sorted(unknown))}, which neither "
                "measure returns nor the layout's state has"
            )
        info = info | {name: known[name] for name in self.task.needs}
        for name in self.task.own_info:
            self._number(f"measure: {name}, which own_info has,", info.get(name))
        return info

    def _number(self, function: str, value: Any) -> float:
        """What a function of the task returned for one goal."""
        if not _is_number(value):
            raise LayoutError(
                f"{self._name}.{function} is {value!r:.60}, expected one value for one "
                "goal"
            )
        if not math.isfinite(number := float(value)):
            raise MarlMmError(
                f"{self._name}.{function} is {value!r:.60}, expected a finite number"
            )
        return number

    @property
    def _name(self) -> str:
        return type(self.task).__name__

    def _state(self, attempt: Attempt) -> np.ndarray:
        layout = self.task.layout
        observed = self.task.observe(attempt)
        if np.shape(attempt.goal) != (len(layout.desired),):
            raise LayoutError(
                f"{self._name}.begin set the goal {attempt.goal!r:.60}, "
                f"expected {len(layout.desired)} numbers: {', '.join(layout.desired)}"
            )
        whose = f"{self._name}.observe"
        if not isinstance(observed, Mapping):
            raise LayoutError(f"{whose} is {observed!r:.60}, expected a dict")
        seen = {**observed, **dict(zip(layout.desired, attempt.goal, strict=True))}
        try:
            state = np.array([seen[name] for name in layout.state_names], np.float64)
        except KeyError as error:
            raise LayoutError(
                f"{whose} returns no {error.args[0]!r}, which the task's layout has"
            ) from None
        except (TypeError, ValueError):
            state = np.empty(0)
        if state.shape != (len(layout.state),):
            odd = next(n for n in layout.state_names if not _is_number(seen[n]))
            raise LayoutError(f"{whose}: {odd} is {seen[odd]!r:.60}, expected a number")
        if not np.isfinite(state).all():
            odd = np.flatnonzero(~np.isfinite(state))[0]
            raise MarlMmError(f"{whose}: {layout.state[odd]} is {state[odd]}")
        return state

    def _checked(self, action: np.ndarray) -> np.ndarray:
        try:
            values = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InvalidActionError(
                f"action is {action!r}, expected numbers"
            ) from error
        if values.shape != self._low.shape:
            raise InvalidActionError(
                f"action has shape {values.shape}, expected {self._low.shape}: "
                f"{', '.join(self.task.layout.action_names)}"
            )
        if not np.isfinite(values).all():
            raise InvalidActionError(
                f"action is {values.tolist()}, expected finite numbers: check the "
                "policy's input for NaN"
            )
        return values


def motion_info(motions: Sequence[Motion]) -> dict[str, Any]:
    """Step numbers of ``MOTION_INFO``; of several robots the worst, or the sum."""
    jerks = [np.diff(motion.base_acceleration) * RATE for motion in motions]
    return {
        "base_jerk_rms": max(map(_rms, jerks)),
        "base_acceleration_rms": max(_rms(m.base_acceleration) for m in motions),
        "zmp_margin": min(m.zmp_margin for m in motions),
        "tilt": max(m.tilt for m in motions),
        "base_pitch": max((m.base_pitch for m in motions), key=abs),
        "wheel_slip": max(m.wheel_slip for m in motions),
        "model_ee_error": max(m.model_ee_error for m in motions),
        "qp_failures": sum(m.qp_failures for m in motions),
        "safe_ticks": sum(m.safe_ticks for m in motions),
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values * values))) if len(values) else 0.0


def _is_number(value: Any) -> bool:
    """Whether a task's own value is one number, an array without axes among them."""
    if isinstance(value, int | float):
        return True
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        return False
    return array.ndim == 0 and array.dtype.kind in "biuf"
