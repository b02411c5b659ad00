"""The whole-body controller: from state and reference to base acceleration and torques.

Variables u, shape (9,): base forward [m/s^2], base yaw [rad/s^2], seven arm joints
[rad/s^2]. Five tasks compete for them (Table 1 of the paper); alpha sets their
priorities: 1 a stable base first, 0 an accurate hand (Eq. 4).
"""

from collections.abc import Callable, Iterator, Mapping
from importlib.util import find_spec
from typing import Any, NamedTuple, TypeVar

import numpy as np

from marl_mm.control.compiled.along import packed, tick_along
from marl_mm.control.compiled.tick import tick
from marl_mm.control.config import ControllerConfig, Gains, HierarchyConfig, LimitConfig
from marl_mm.control.limits import row_count
from marl_mm.control.priorities import (
    REACHING,
    STABILITY,
    priority_matrix,
    stability_share,
)
from marl_mm.control.records import (
    VARIABLES,
    Command,
    Priorities,
    Reference,
    ReferenceAt,
    Track,
    checked,
)
from marl_mm.errors import NonFiniteStateError, UsageError
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ModelTerms, RobotState, named


class WholeBodyController:
    """One controller for one robot; it keeps no state between ticks.

    Args:
        robot: Limits of the robot.
        config: Form, solver and gains.
        rate: Ticks per second.

    Raises:
        UsageError: If the solver is not installed.
    """

    def __init__(
        self, robot: RobotLimits, config: ControllerConfig, rate: float = 240.0
    ) -> None:
        if config.solver == "daqp" and find_spec("daqp") is None:
            raise UsageError(
                'solver "daqp" needs the package daqp: pip install -e ".[bench]"'
            )
        self.config = config
        self._rate = float(rate)
        self._robot = robot
        hierarchy = config.hierarchy
        if config.form == "rhp-literal":
            hierarchy = hierarchy._replace(rho=0.0, weighted=False)
        # The compiled form has one signature: numbers keep the type of their default.
        self._gains = Gains(*_typed(Gains(), config.gains))
        self._hierarchy = HierarchyConfig(*_typed(HierarchyConfig(), hierarchy))
        self._limits = LimitConfig(*_typed(LimitConfig(), config.limits))
        self.rows = row_count(self._limits)
        numbers = (
            tuple(robot),
            tuple(self._gains),
            tuple(self._hierarchy),
            tuple(self._limits),
        )
        self.numbers: tuple[Any, Any, Any, Any] = numbers
        self._packed = packed(
            (*robot, *self._gains, *self._hierarchy, *self._limits, self._rate)
        )

    def tick(
        self, state: RobotState, terms: ModelTerms, reference: Reference, alpha: float
    ) -> Command:
        """``solve`` with the priorities of alpha: 0 reaching ... 1 stability first."""
        return self.solve(state, terms, reference, self.priorities(alpha))

    def priorities(self, alpha: float) -> Priorities:
        """Priorities at alpha: 0 reaching first ... 1 stability first.

        Raises:
            UsageError: If alpha is not in [0, 1].
        """
        if not 0.0 <= alpha <= 1.0:
            raise UsageError(f"alpha is {alpha}, expected a number in [0, 1]")
        share = stability_share(alpha, self.config.response)
        if self.config.form != "blend" or share in (0.0, 1.0):
            return Priorities(priority_matrix(share)[None], np.ones(1))
        return Priorities(
            np.stack([STABILITY, REACHING]), np.array([share, 1.0 - share])
        )

    def solve(
        self,
        state: RobotState,
        terms: ModelTerms,
        reference: Reference,
        priorities: Priorities,
    ) -> Command:
        """Solve the hierarchy at one state.

        Args:
            state: The robot now.
            terms: The model at that state.
            reference: Targets of the tasks.
            priorities: Priorities of the tasks.

        Raises:
            NonFiniteStateError: If the command would not be finite.
            UsageError: If an array of state, reference or priorities has another shape,
                or ``limits.zmp`` is on and the terms have no wrench. Shapes of the
                terms are not checked.
        """
        if self._limits.zmp:
            self._check_wrench(terms)
        hierarchies = np.size(priorities.shares)
        of_priorities = {"matrices": (hierarchies, 4, 5), "shares": (hierarchies,)}
        # Compiled code would read what lies behind shorter arrays.
        state = _arrays(state, _STATE_SHAPES)
        reference = _arrays(reference, _REFERENCE_SHAPES)
        priorities = _arrays(priorities, of_priorities)
        if self.config.solver == "active-set":
            command, finite = self._compiled(state, terms, reference, priorities)
        else:
            command = self._readable(state, terms, reference, priorities)
            finite = bool(np.isfinite(command.torque).all())
        if not finite:
            raise no_command_error(state, reference.ee_position_w, priorities)
        return command

    def along(
        self, reference_at: ReferenceAt, priorities: Priorities
    ) -> Callable[[int, RobotState, ModelTerms], Command]:
        """``solve`` for many ticks: a function of tick, state and the model's terms.

        It is faster where the reference is a ``Track``.

        Args:
            reference_at: Reference of the tasks at a tick and state.
            priorities: Priorities of the tasks.

        Raises:
            UsageError: If an array of a ``Track`` or of the priorities has another
                shape.
        """
        track = reference_at
        if self.config.solver != "active-set" or not isinstance(track, Track):
            return lambda k, state, terms: self.solve(
                state, terms, reference_at(k, state), priorities
            )
        track, priorities = checked(track, priorities)
        line = packed(track._replace(points=np.empty(0)))
        unchanging = self._packed, line, track.points, *priorities

        balance = self._limits.zmp

        def command(k: int, state: RobotState, terms: ModelTerms) -> Command:
            if balance:
                self._check_wrench(terms)
            u, torque = np.empty(VARIABLES), np.empty(7)
            finite, rest = tick_along(*state, *terms, k, *unchanging, u, torque)
            if not finite:
                raise no_command_error(state, track.target_w, priorities)
            return named(Command, (u, torque, *rest))

        return command

    def _check_wrench(self, terms: ModelTerms) -> None:
        if not terms.wrench.any():
            raise UsageError(
                "limits.zmp is on, but the model gives no wrench: "
                "RobotModel(config, balance=True)"
            )

    def _compiled(
        self,
        state: RobotState,
        terms: ModelTerms,
        reference: Reference,
        priorities: Priorities,
    ) -> tuple[Command, bool]:
        u, torque, counters = np.empty(VARIABLES), np.empty(7), np.zeros(4, np.int64)
        feasible, finite, forward, turning = tick(
            tuple(state),
            tuple(terms),
            tuple(reference),
            *self.numbers,
            *priorities,
            self.rows,
            self._rate,
            u,
            torque,
            counters,
        )
        levels, qps, failures, cause = counters.tolist()
        safe, speed = not feasible, (forward, turning)
        command = Command(u, torque, speed, levels, qps, failures, cause, safe)
        return command, finite

    def _readable(
        self,
        state: RobotState,
        terms: ModelTerms,
        reference: Reference,
        priorities: Priorities,
    ) -> Command:
        from marl_mm.control.reference import controller, qp  # nothing else needs them

        return controller.tick(
            state,
            terms,
            reference,
            self._robot,
            self._gains,
            self._hierarchy,
            self._limits,
            priorities,
            self._rate,
            qp.daqp if self.config.solver == "daqp" else qp.proxqp,
        )


_REFERENCE_SHAPES = {
    "ee_position_w": (3,),
    "ee_rotation_w": (3, 3),
    "base_position_w": (2,),
    "posture": (7,),
}
"""Shapes of a reference's arrays."""

_STATE_SHAPES = {"q": (11,), "v": (10,)}
"""Shapes of a state's arrays."""

_T = TypeVar("_T", bound=NamedTuple)


def _arrays(values: _T, shapes: Mapping[str, tuple[int, ...]]) -> _T:
    """Copy of a tuple whose named arrays are of float64.

    Raises:
        UsageError: If an array has another shape.
    """
    arrays = {}
    for name, shape in shapes.items():
        array = np.ascontiguousarray(getattr(values, name), np.float64)
        if array.shape != shape:
            raise UsageError(f"{name} has shape {array.shape}, expected {shape}")
        arrays[name] = array
    return values._replace(**arrays)


def no_command_error(
    state: RobotState, target_w: np.ndarray, priorities: Priorities
) -> NonFiniteStateError:
    """Error of a tick without a finite command.

    Args:
        state: The robot then.
        target_w: Target of the end-effector, shape (3,) [m].
        priorities: Priorities of the tasks.
    """
    return NonFiniteStateError(
        f"the controller found no finite command at q = {state.q.tolist()}, "
        f"v = {state.v.tolist()}, target {target_w.tolist()}, "
        f"shares {priorities.shares.tolist()}"
    )


def _typed(defaults: NamedTuple, values: NamedTuple) -> Iterator[Any]:
    for default, value in zip(defaults, values, strict=True):
        yield type(default)(value)
