"""Parts of the compiled tick, repeated: the benchmark cannot see them from outside."""

from typing import Any

import numpy as np

from marl_mm.control.compiled.assembly import assemble_limits, assemble_tasks
from marl_mm.control.compiled.hierarchy import solve_hierarchy
from marl_mm.control.config import Gains, HierarchyConfig, LimitConfig
from marl_mm.control.records import Reference
from marl_mm.jit import jit
from marl_mm.robot.limits import RobotLimits
from marl_mm.robot.model import ModelTerms, RobotState


@jit
def repeat_assembly(
    state: tuple[Any, ...],
    terms: tuple[Any, ...],
    reference: tuple[Any, ...],
    robot: tuple[Any, ...],
    gains: tuple[Any, ...],
    limits: tuple[Any, ...],
    jacobian: np.ndarray,
    target: np.ndarray,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    repeats: int,
) -> None:
    """Write the rows of all tasks and limits, which are zero before.

    Arguments are those of ``tick``, ``assemble_tasks`` and ``assemble_limits``.
    """
    state_, terms_ = RobotState(*state), ModelTerms(*terms)
    reference_, robot_ = Reference(*reference), RobotLimits(*robot)
    gains_, limits_ = Gains(*gains), LimitConfig(*limits)
    for _ in range(repeats):
        assemble_tasks(state_, terms_, reference_, gains_, jacobian, target)
        assemble_limits(state_, terms_, robot_, limits_, matrix, lower, upper)


@jit
def repeat_levels(
    jacobian: np.ndarray,
    target: np.ndarray,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    priorities: np.ndarray,
    hierarchy: tuple[Any, ...],
    u: np.ndarray,
    counters: np.ndarray,
    repeats: int,
) -> None:
    """All levels of all hierarchies; arguments are those of ``solve_hierarchy``."""
    config = HierarchyConfig(*hierarchy)
    for _ in range(repeats):
        for m in range(priorities.shape[0]):
            solve_hierarchy(
                jacobian,
                target,
                priorities[m],
                matrix,
                lower,
                upper,
                config,
                u,
                counters,
            )
