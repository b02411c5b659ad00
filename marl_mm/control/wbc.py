"""The whole-body controller: from state and reference to base acceleration and torques.

Variables u, shape (9,): base forward [m/s^2], base yaw [rad/s^2], seven arm joints
[rad/s^2]. Five tasks compete for them (Table 1 of the paper); alpha says who comes
first: 1 a stable base, 0 an accurate hand (Eq. 4).
"""

from typing import Any, NamedTuple

import numpy as np

from marl_mm.control.compiled.tick import tick
from marl_mm.control.config import ControllerConfig, Gains, HierarchyConfig, LimitConfig
from marl_mm.control.hierarchy import Solution, solve_hierarchy
from marl_mm.control.limits import TORQUE_ROWS, bounds
from marl_mm.control.priorities import REACHING, STABILITY, priority_matrix
from marl_mm.control.tasks.arm_posture import arm_posture
from marl_mm.control.tasks.base_orientation import base_orientation
from marl_mm.control.tasks.base_velocity import base_velocity
from marl_mm.control.tasks.manipulator_orientation import manipulator_orientation
from marl_mm.control.tasks.manipulator_position import manipulator_position
from marl_mm.control.tasks.task import VARIABLES, Reference, Task
from marl_mm.errors import NonFiniteStateError, UsageError
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ModelTerms, RobotState


class Command(NamedTuple):
    """What the robot shall do until the next tick."""

    acceleration: np.ndarray
    """u, shape (9,)."""

    torque: np.ndarray
    """Of the arm joints, clipped to their limits, shape (7,) [N m]."""

    levels: int
    """Levels of the hierarchy solved."""

    qps: int
    """Levels that needed a QP, because the closed form broke a limit."""

    failures: int
    """Levels whose QP failed, and which were skipped."""


class WholeBodyController:
    """One controller for one robot; it keeps no state between ticks.

    Args:
        robot: Limits of the robot.
        config: Form, solver and gains.
    """

    def __init__(self, robot: RobotLimits, config: ControllerConfig) -> None:
        self.config = config
        self._robot = robot
        # The compiled form has one signature: every number a float.
        self._gains = Gains(*map(float, config.gains))
        numbers: dict[str, Any] = {
            name: float(value) for name, value in config.hierarchy._asdict().items()
        }
        numbers["iterations"] = int(config.hierarchy.iterations)
        self._hierarchy = HierarchyConfig(**numbers)
        self._limits = LimitConfig(*map(float, config.limits))
        self._alpha = -1.0

    def tick(
        self, state: RobotState, terms: ModelTerms, reference: Reference, alpha: float
    ) -> Command:
        """Solve the hierarchy at one state.

        Args:
            state: The robot now.
            terms: The model at that state.
            reference: What the tasks follow.
            alpha: 0 reaching first ... 1 stability first.

        Raises:
            NonFiniteStateError: If the state holds, or the solution would hold, a NaN.
        """
        if alpha != self._alpha:
            self._set_alpha(alpha)
        if self.config.solver == "active-set":
            command, finite = self._compiled(state, terms, reference)
        else:
            command = self._readable(state, terms, reference)
            finite = bool(np.isfinite(command.torque).all())
        if not finite:
            raise NonFiniteStateError(
                f"the controller found no finite command at q = {state.q.tolist()}, "
                f"v = {state.v.tolist()}, target {reference.ee_position_w.tolist()}, "
                f"alpha {alpha}"
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

    def _set_alpha(self, alpha: float) -> None:
        if not 0.0 <= alpha <= 1.0:
            raise UsageError(f"alpha is {alpha}, expected a number in [0, 1]")
        self._alpha = alpha
        if self.config.form == "rhp" or alpha in (0.0, 1.0):
            self._priorities = priority_matrix(alpha)[None]
            self._shares = np.ones(1)
        else:
            self._priorities = np.stack([STABILITY, REACHING])
            self._shares = np.array([alpha, 1 - alpha])

    def _compiled(
        self, state: RobotState, terms: ModelTerms, reference: Reference
    ) -> tuple[Command, bool]:
        u, torque, counters = np.empty(VARIABLES), np.empty(7), np.zeros(3, np.int64)
        finite = tick(
            state,
            terms,
            reference,
            self._robot,
            self._gains,
            self._hierarchy,
            self._limits,
            self._priorities,
            self._shares,
            u,
            torque,
            counters,
        )
        return Command(u, torque, *counters.tolist()), finite

    def _readable(
        self, state: RobotState, terms: ModelTerms, reference: Reference
    ) -> Command:
        tasks = self.tasks(state, terms, reference)
        limits = bounds(state, terms, self._robot, self._limits)
        solutions: list[Solution] = [
            solve_hierarchy(tasks, psi, limits, self._hierarchy)
            for psi in self._priorities
        ]
        u = sum(
            (
                share * solution.acceleration
                for share, solution in zip(self._shares, solutions, strict=True)
            ),
            start=np.zeros(VARIABLES),
        )
        torque = limits.matrix[TORQUE_ROWS] @ u + terms.nonlinear[3:]
        return Command(
            u,
            np.clip(torque, -self._robot.torque, self._robot.torque),
            sum(solution.levels for solution in solutions),
            sum(solution.qps for solution in solutions),
            sum(solution.failures for solution in solutions),
        )
