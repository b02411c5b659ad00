"""One controller tick, the readable form: tasks, limits, hierarchies, torques."""

import numpy as np

from marl_mm.control.config import Gains, HierarchyConfig, LimitConfig
from marl_mm.control.limits import TORQUE_ROWS, WHEEL_ARM
from marl_mm.control.records import VARIABLES, Command, Priorities, Reference
from marl_mm.control.reference.hierarchy import solve_hierarchy
from marl_mm.control.reference.limits import bounds
from marl_mm.control.reference.qp import NO_CAUSE, SolveQp
from marl_mm.control.reference.safe import braking_acceleration, broken_row
from marl_mm.control.reference.tasks.arm_posture import arm_posture
from marl_mm.control.reference.tasks.base_orientation import base_orientation
from marl_mm.control.reference.tasks.base_velocity import base_velocity
from marl_mm.control.reference.tasks.manipulator_orientation import (
    manipulator_orientation,
)
from marl_mm.control.reference.tasks.manipulator_position import manipulator_position
from marl_mm.control.reference.tasks.task import Task
from marl_mm.robot.description import WHEEL_RADIUS
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ModelTerms, RobotState


def tasks_at(
    state: RobotState, terms: ModelTerms, reference: Reference, gains: Gains
) -> list[Task]:
    """The five tasks at a state, in the order of Table 1."""
    return [
        base_velocity(state, reference, gains),
        base_orientation(state, reference, gains),
        manipulator_position(terms, reference, gains),
        manipulator_orientation(terms, reference, gains),
        arm_posture(state, reference, gains),
    ]


def tick(
    state: RobotState,
    terms: ModelTerms,
    reference: Reference,
    robot: RobotLimits,
    gains: Gains,
    hierarchy: HierarchyConfig,
    limits: LimitConfig,
    priorities: Priorities,
    rate: float,
    solve_qp: SolveQp,
) -> Command:
    """The command at a state.

    Args:
        state: The robot now.
        terms: The model at that state.
        reference: Targets of the tasks.
        robot: Limits of the robot.
        gains: Feedback rates of the tasks.
        hierarchy: Numbers of the recursion.
        limits: Parameters of the limits.
        priorities: Hierarchies and their shares.
        rate: Ticks per second.
        solve_qp: Solver of the levels whose closed form breaks a limit.
    """
    tasks = tasks_at(state, terms, reference, gains)
    rows = bounds(state, terms, robot, limits)
    solutions = [
        solve_hierarchy(tasks, psi, rows, hierarchy, solve_qp)
        for psi in priorities.matrices
    ]
    feasible = all(solution.feasible for solution in solutions)
    if feasible:
        u = np.zeros(VARIABLES)
        for share, solution in zip(priorities.shares, solutions, strict=True):
            u += share * solution.acceleration
    else:
        u = braking_acceleration(state, rows)
    torque = rows.matrix[TORQUE_ROWS] @ u + terms.nonlinear[3:]
    causes = [solution.cause for solution in solutions if solution.failures]
    broken = None if feasible else broken_row(u, rows)
    if broken is not None:
        causes.append(broken)
    return Command(
        u,
        np.clip(torque, -robot.torque, robot.torque),
        _base_speed(state, u, robot, rate),
        sum(solution.levels for solution in solutions),
        sum(solution.qps for solution in solutions),
        sum(solution.failures for solution in solutions),
        causes[-1] if causes else NO_CAUSE,
        not feasible,
    )


def _base_speed(
    state: RobotState, u: np.ndarray, robot: RobotLimits, rate: float
) -> tuple[float, float]:
    most, most_turning = robot.speed[:2]
    forward = np.clip(state.v[0] + u[0] / rate, -most, most)
    rim = robot.wheel_speed * WHEEL_RADIUS
    most_turning = min(most_turning, (rim - abs(forward)) / WHEEL_ARM)
    turning = np.clip(state.v[2] + u[1] / rate, -most_turning, most_turning)
    return float(forward), float(turning)
