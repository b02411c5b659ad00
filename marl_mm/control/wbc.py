"""The whole-body controller: from state and reference to base acceleration and torques.

Variables u, shape (9,): base forward [m/s^2], base yaw [rad/s^2], seven arm joints
[rad/s^2]. Five tasks compete for them (Table 1 of the paper); alpha says who comes
first: 1 a stable base, 0 an accurate hand (Eq. 4).
"""

from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from marl_mm.control.compiled.tick import tick
from marl_mm.control.config import ControllerConfig, Gains, HierarchyConfig, LimitConfig
from marl_mm.control.hierarchy import Solution, solve_hierarchy
from marl_mm.control.limits import (
    LIMIT_NAMES,
    TORQUE_ROWS,
    WHEEL_ARM,
    bounds,
    row_count,
)
from marl_mm.control.priorities import (
    REACHING,
    STABILITY,
    priority_matrix,
    stability_share,
)
from marl_mm.control.qp import NO_CAUSE, daqp, proxqp
from marl_mm.control.safe import braking_acceleration, broken_row
from marl_mm.control.tasks.arm_posture import arm_posture
from marl_mm.control.tasks.base_orientation import base_orientation
from marl_mm.control.tasks.base_velocity import base_velocity
from marl_mm.control.tasks.manipulator_orientation import manipulator_orientation
from marl_mm.control.tasks.manipulator_position import manipulator_position
from marl_mm.control.tasks.task import VARIABLES, Reference, Task
from marl_mm.errors import NonFiniteStateError, UsageError
from marl_mm.robot.description import WHEEL_RADIUS
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ModelTerms, RobotState


class Command(NamedTuple):
    """What the robot shall do until the next tick."""

    acceleration: np.ndarray
    """u, shape (9,)."""

    torque: np.ndarray
    """Of the arm joints, clipped to their limits, shape (7,) [N m]."""

    base_speed: tuple[float, float]
    """For the wheels: forward [m/s], yaw rate [rad/s]. The measured speeds plus u over
    a tick: an integral of u alone would go on while the wheels slip, and jerk the base
    when they grip again."""

    levels: int
    """Levels of the hierarchy solved."""

    qps: int
    """Levels that needed a QP, because the closed form broke a limit."""

    failures: int
    """Levels whose QP failed, and which were skipped."""

    cause: int
    """The last failure's, see ``reason``."""

    safe: bool
    """Whether no acceleration met all limits, so that the command only brakes."""

    @property
    def reason(self) -> str | None:
        """What stood in the way of the last failed level, in words.

        Of a command that only brakes: the limit that even braking breaks, most of all.
        """
        if self.failures == 0:
            return None
        if self.cause < 0:
            return "the QP ran out of iterations"
        return f"{LIMIT_NAMES[self.cause]}: out of reach within the other limits"


class Priorities(NamedTuple):
    """Who comes first: one hierarchy, or a mix of several."""

    matrices: np.ndarray
    """Cumulative priority matrices, shape (m, 4, 5)."""

    shares: np.ndarray
    """Weight of each hierarchy's solution in u, shape (m,)."""


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
                'solver "daqp" needs the package daqp: pip install "marl-mm[bench]"'
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

    def tick(
        self, state: RobotState, terms: ModelTerms, reference: Reference, alpha: float
    ) -> Command:
        """``solve`` with the priorities of alpha: 0 reaching ... 1 stability first."""
        return self.solve(state, terms, reference, self.priorities(alpha))

    def priorities(self, alpha: float) -> Priorities:
        """Who comes first at alpha: 0 reaching ... 1 stability.

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
            reference: What the tasks follow.
            priorities: Who comes first.

        Raises:
            NonFiniteStateError: If the state holds, or the solution would hold, a NaN.
        """
        if self._limits.zmp and not terms.wrench.any():
            raise UsageError(
                "limits.zmp is on, but the model gives no wrench: "
                "RobotModel(config, balance=True)"
            )
        if self.config.solver == "active-set":
            command, finite = self._compiled(state, terms, reference, priorities)
        else:
            command = self._readable(state, terms, reference, priorities)
            finite = bool(np.isfinite(command.torque).all())
        if not finite:
            raise NonFiniteStateError(
                f"the controller found no finite command at q = {state.q.tolist()}, "
                f"v = {state.v.tolist()}, target {reference.ee_position_w.tolist()}, "
                f"shares {priorities.shares.tolist()}"
            )
        return command

    def tasks(
        self, state: RobotState, terms: ModelTerms, reference: Reference
    ) -> list[Task]:
        """The five tasks at a state, in the order of Table 1."""
        gains = self._gains
        return [
            base_velocity(state, reference, gains),
            base_orientation(state, reference, gains),
            manipulator_position(terms, reference, gains),
            manipulator_orientation(terms, reference, gains),
            arm_posture(state, reference, gains),
        ]

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
        tasks = self.tasks(state, terms, reference)
        limits = bounds(state, terms, self._robot, self._limits)
        solve_qp = daqp if self.config.solver == "daqp" else proxqp
        solutions: list[Solution] = [
            solve_hierarchy(tasks, psi, limits, self._hierarchy, solve_qp)
            for psi in priorities.matrices
        ]
        feasible = all(solution.feasible for solution in solutions)
        if feasible:
            u = np.zeros(VARIABLES)
            for share, solution in zip(priorities.shares, solutions, strict=True):
                u += share * solution.acceleration
        else:
            u = braking_acceleration(state, limits)
        torque = limits.matrix[TORQUE_ROWS] @ u + terms.nonlinear[3:]
        causes = [solution.cause for solution in solutions if solution.failures]
        broken = None if feasible else broken_row(u, limits)
        if broken is not None:
            causes.append(broken)
        return Command(
            u,
            np.clip(torque, -self._robot.torque, self._robot.torque),
            self._base_speed(state, u),
            sum(solution.levels for solution in solutions),
            sum(solution.qps for solution in solutions),
            sum(solution.failures for solution in solutions),
            causes[-1] if causes else NO_CAUSE,
            not feasible,
        )

    def _base_speed(self, state: RobotState, u: np.ndarray) -> tuple[float, float]:
        most, most_turning = self._robot.speed[:2]
        forward = np.clip(state.v[0] + u[0] / self._rate, -most, most)
        rim = self._robot.wheel_speed * WHEEL_RADIUS
        most_turning = min(most_turning, (rim - abs(forward)) / WHEEL_ARM)
        turning = np.clip(state.v[2] + u[1] / self._rate, -most_turning, most_turning)
        return float(forward), float(turning)


def _typed(defaults: NamedTuple, values: NamedTuple) -> Iterator[Any]:
    for default, value in zip(defaults, values, strict=True):
        yield type(default)(value)
