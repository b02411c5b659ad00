"""The hierarchy against independent solvers, and its own promises."""

from collections.abc import Callable
from dataclasses import replace

import daqp
import numpy as np
import pytest
import quadprog
from hypothesis import example, given, settings
from hypothesis import strategies as st

from marl_mm.control.compiled import hierarchy as compiled
from marl_mm.control.config import (
    Gains,
    HierarchyConfig,
    LimitConfig,
)
from marl_mm.control.limits import TORQUE_ROWS, UNBOUNDED
from marl_mm.control.priorities import (
    REACHING,
    REACHING_LEVELS,
    STABILITY,
    STABILITY_LEVELS,
    priority_matrix,
)
from marl_mm.control.records import Reference
from marl_mm.control.reference.controller import tasks_at
from marl_mm.control.reference.hierarchy import solve_hierarchy
from marl_mm.control.reference.limits import Bounds, bounds
from marl_mm.control.reference.qp import daqp as solve_by_daqp
from marl_mm.control.reference.tasks.task import Task
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.limits import RobotLimits, robot_limits
from marl_mm.robot.model import ModelTerms, RobotModel, RobotState

Draw = Callable[[np.random.Generator], tuple[RobotState, ModelTerms, Reference]]
Problem = tuple[list[Task], Bounds]
ENDS = [(STABILITY, STABILITY_LEVELS), (REACHING, REACHING_LEVELS)]
END_NAMES = ["alpha 1", "alpha 0"]
LIMITS = robot_limits(RobotConfig())
MODEL = RobotModel(RobotConfig())
STATES = 1000


def problem_at(
    state: RobotState, terms: ModelTerms, reference: Reference, limits: RobotLimits
) -> Problem:
    tasks = tasks_at(state, terms, reference, Gains())
    return tasks, bounds(state, terms, limits, LimitConfig())


def problems(draw: Draw, limits: RobotLimits, seed: int, count: int) -> list[Problem]:
    rng = np.random.default_rng(seed)
    return [problem_at(*draw(rng), limits) for _ in range(count)]


def without_limits(rows: Bounds) -> Bounds:
    wide = np.full(len(rows.lower), UNBOUNDED)
    return replace(rows, lower=-wide, upper=wide)


def unit_rows(rows: Bounds) -> Bounds:
    """The same limits, each row of length one where it has a length."""
    norm = np.linalg.norm(rows.matrix, axis=1)
    norm[norm < 1e-9] = 1.0
    matrix = np.ascontiguousarray(rows.matrix / norm[:, None])
    return Bounds(matrix, rows.lower / norm, rows.upper / norm)


def solve_by_quadprog(
    hessian: np.ndarray, target: np.ndarray, room: Bounds
) -> np.ndarray:
    """Raises ValueError where the limits are inconsistent."""
    some = np.linalg.norm(room.matrix, axis=1) > 0.5
    above, below = some & (room.lower > -1e6), some & (room.upper < 1e6)
    if not (above | below).any():
        return np.linalg.solve(hessian, target)
    rows = np.concatenate([room.matrix[above], -room.matrix[below]])
    least = np.concatenate([room.lower[above], -room.upper[below]])
    x: np.ndarray = quadprog.solve_qp(hessian, target, rows.T.copy(), least)[0]
    return x


def cascade(
    tasks: list[Task], levels: tuple[int, ...], limits: Bounds, damping: float
) -> np.ndarray:
    """Lexicographic least squares by null-space elimination (SVD) and quadprog.

    Shares nothing with the code under test: no recursion of projectors, another QP
    solver on normalised rows.
    """
    u, null = np.zeros(9), np.eye(9)
    for level in sorted(set(levels)):
        if null.shape[1] == 0:
            break
        handled = [t for t, own in zip(tasks, levels, strict=True) if own == level]
        jacobian = np.concatenate([task.jacobian for task in handled]) @ null
        residual = np.concatenate([t.target - t.jacobian @ u for t in handled])
        used = limits.matrix @ u
        lower, upper = limits.lower - used, limits.upper - used
        if level > min(levels):
            lower = np.minimum(lower, 0.0) - HierarchyConfig().margin
            upper = np.maximum(upper, 0.0) + HierarchyConfig().margin
        room = unit_rows(Bounds(limits.matrix @ null, lower, upper))
        z = solve_by_quadprog(
            jacobian.T @ jacobian + damping * np.eye(null.shape[1]),
            jacobian.T @ residual,
            room,
        )
        u = u + null @ z
        _, singular, basis = np.linalg.svd(jacobian)
        null = null @ basis[int((singular > 1e-5).sum()) :].T
    return u


def native_hierarchy(
    tasks: list[Task], levels: tuple[int, ...], limits: Bounds
) -> np.ndarray:
    """DAQP's own strict hierarchy in one call."""
    room = unit_rows(limits)
    matrix, lower, upper = [room.matrix], [room.lower], [room.upper]
    breaks = [len(room.lower)]
    for level in sorted(set(levels)):
        handled = [t for t, own in zip(tasks, levels, strict=True) if own == level]
        target = np.concatenate([task.target for task in handled])
        matrix.append(np.concatenate([task.jacobian for task in handled]))
        lower.append(target)
        upper.append(target)
        breaks.append(breaks[-1] + len(target))
    u, _, flag, _ = daqp.solve(
        np.eye(9),
        np.zeros(9),
        np.ascontiguousarray(np.concatenate(matrix)),
        np.concatenate(upper),
        np.concatenate(lower),
        np.zeros(breaks[-1], np.int32),
        break_points=np.array(breaks, np.int32),
    )
    assert flag > 0
    return np.array(u)


def level_residuals(
    tasks: list[Task], levels: tuple[int, ...], u: np.ndarray
) -> np.ndarray:
    squares = np.zeros(4)
    for task, level in zip(tasks, levels, strict=True):
        squares[level - 1] += np.sum((task.jacobian @ u - task.target) ** 2)
    return np.sqrt(squares)


def compiled_solution(
    problem: Problem, psi: np.ndarray, config: HierarchyConfig
) -> tuple[np.ndarray, np.ndarray]:
    """u and the counters of the compiled form."""
    tasks, rows = problem
    u, counters = np.empty(9), np.zeros(4, np.int64)
    compiled.solve_hierarchy(
        np.concatenate([task.jacobian for task in tasks]),
        np.concatenate([task.target for task in tasks]),
        psi,
        rows.matrix,
        rows.lower,
        rows.upper,
        config,
        u,
        counters,
    )
    return u, counters


@pytest.mark.slow
@pytest.mark.parametrize("strength", [None, 1.0, 0.4], ids=["free", "limits", "weak"])
@pytest.mark.parametrize(("psi", "levels"), ENDS, ids=END_NAMES)
def test_strict_ends_equal_the_damped_oracle_in_every_variable(
    situation: Draw,
    psi: np.ndarray,
    levels: tuple[int, ...],
    strength: float | None,
) -> None:
    """u itself to 1e-4 on 1,000 states: without limits, with, and with a weak arm."""
    config = HierarchyConfig(projector_damping=1e-14)
    limits = LIMITS._replace(torque=(strength or 1.0) * LIMITS.torque)
    torque_limited = limited = inconsistent = 0
    for tasks, rows in problems(situation, limits, seed=19, count=STATES):
        used = rows if strength else without_limits(rows)
        u, counters = compiled_solution((tasks, used), psi, config)
        try:
            expected = cascade(tasks, levels, used, config.damping)
        except ValueError:
            assert counters[compiled.FAILURES] > 0
            inconsistent += 1
            continue
        assert counters[compiled.FAILURES] == 0
        np.testing.assert_allclose(u, expected, atol=1e-4)
        limited += counters[compiled.QPS] > 0
        value = rows.matrix[TORQUE_ROWS] @ u
        at_limit = (value > rows.upper[TORQUE_ROWS] - 1e-6).any()
        torque_limited += at_limit or (value < rows.lower[TORQUE_ROWS] + 1e-6).any()
    assert limited == 0 if strength is None else limited >= STATES / 2
    assert inconsistent <= (STATES / 50 if strength == 0.4 else 0)
    if strength == 0.4:
        assert torque_limited >= STATES / 20


@pytest.mark.slow
@pytest.mark.parametrize(("psi", "levels"), ENDS, ids=END_NAMES)
def test_what_the_default_damping_costs(
    situation: Draw, psi: np.ndarray, levels: tuple[int, ...]
) -> None:
    """With the projector damped as it runs, u itself differs; what it achieves hardly.

    A direction that a higher level holds weakly is closed by n^2 / (n^2 + 1e-3) only,
    and u may use it: by up to tens of rad/s^2 in an ill-conditioned state. The residual
    of every level above the posture is hardly worse than the oracle's: by less than 0.1
    (m/s^2, rad/s^2) in 99 % of the states, by 0.24 at most when this was written.
    """
    excess = []
    config = HierarchyConfig()
    for tasks, rows in problems(situation, LIMITS, seed=29, count=STATES):
        u, counters = compiled_solution((tasks, rows), psi, config)
        assert counters[compiled.FAILURES] == 0
        expected = cascade(tasks, levels, rows, config.damping)
        more = level_residuals(tasks, levels, u)
        excess.append(more - level_residuals(tasks, levels, expected))
    above_posture = np.array(excess)[:, :3].max(axis=1)
    assert above_posture.max() < 0.5
    assert np.quantile(above_posture, 0.99) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("psi", "levels"), ENDS, ids=END_NAMES)
def test_with_damping_towards_zero_it_is_the_lexicographic_optimum(
    situation: Draw, psi: np.ndarray, levels: tuple[int, ...]
) -> None:
    """A thousandth of the default damping: no failed level, and the oracle's u.

    Where the oracle's rank decision leaves u undetermined, the residuals still meet:
    level by level to 1e-2, but for less than one state in a hundred, there to 0.1.
    """
    config = HierarchyConfig(damping=1e-6, projector_damping=1e-12)
    distances, worse = [], []
    for tasks, rows in problems(situation, LIMITS, seed=7, count=STATES):
        u, counters = compiled_solution((tasks, rows), psi, config)
        assert counters[compiled.FAILURES] == 0
        expected = cascade(tasks, levels, rows, 1e-9)
        distances.append(np.abs(u - expected).max())
        worse.append(lexicographic_excess(tasks, levels, u, expected, 1e-2))
    assert np.median(distances) < 1e-3  # of accelerations up to 20
    assert np.quantile(worse, 0.99) == 0
    assert max(worse) < 0.1


def lexicographic_excess(
    tasks: list[Task],
    levels: tuple[int, ...],
    u: np.ndarray,
    other: np.ndarray,
    tolerance: float,
) -> float:
    """How much worse u is at the first level where the two differ; 0 if it is not."""
    difference = level_residuals(tasks, levels, u)
    difference -= level_residuals(tasks, levels, other)
    differs = np.nonzero(np.abs(difference) > tolerance)[0]
    return max(float(difference[differs[0]]), 0.0) if len(differs) else 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("psi", "levels"), ENDS, ids=END_NAMES)
def test_daqps_own_hierarchy_agrees_or_is_worse(
    situation: Draw, psi: np.ndarray, levels: tuple[int, ...]
) -> None:
    """A second oracle, in one call and without projectors.

    On 15 to 35 % of the states it gives the cascade's u, and there the code under test
    does, too. On the rest it stops at a residual that is higher at the first level
    where the two differ; but for the few in which its own tolerance of 1e-6 at one
    level buys it something at the next.
    """
    config = HierarchyConfig(damping=1e-6, projector_damping=1e-12)
    ours, better = [], 0
    for tasks, rows in problems(situation, LIMITS, seed=5, count=STATES):
        native = native_hierarchy(tasks, levels, rows)
        expected = cascade(tasks, levels, rows, 1e-9)
        u, counters = compiled_solution((tasks, rows), psi, config)
        assert counters[compiled.FAILURES] == 0
        if np.abs(native - expected).max() < 1e-3:
            ours.append(np.abs(u - native).max())
        else:
            better += lexicographic_excess(tasks, levels, expected, native, 1e-5) > 0
    assert better <= STATES / 100
    assert len(ours) >= STATES / 10
    assert np.median(ours) < 1e-3
    assert np.quantile(ours, 0.9) < 0.1


joints = st.lists(st.floats(0, 1), min_size=7, max_size=7)
speeds = st.lists(st.floats(-1, 1), min_size=9, max_size=9)
offsets = st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3)


def situation_of(
    joints: list[float], speeds: list[float], offset: list[float]
) -> Problem:
    """Any posture within the limits, any speed within them, targets near and far."""
    room = LIMITS.upper - LIMITS.lower
    arm = LIMITS.lower + np.array(joints) * room
    velocity = 0.9 * np.array(speeds) * LIMITS.speed
    q = np.array([0.1, -0.2, 0.8, 0.6, *arm])
    state = RobotState(q, np.array([velocity[0], 0.0, *velocity[1:]]))
    terms = ModelTerms(*(array.copy(order="K") for array in MODEL.evaluate(state)))
    reference = Reference(
        terms.position_w + np.array(offset),
        np.ascontiguousarray(terms.rotation_w),
        q[:2] + np.array(offset[:2]),
        offset[2],
        offset[0],
        np.array(RobotConfig().initial_joints),
    )
    return problem_at(state, terms, reference, LIMITS)


@settings(max_examples=150, deadline=None)
@given(
    joints=joints,
    speeds=speeds,
    offset=offsets,
    end=st.sampled_from(ENDS),
    keep=st.integers(1, 3),
    closed=st.booleans(),
)
def test_a_lower_level_never_worsens_a_higher_one(
    joints: list[float],
    speeds: list[float],
    offset: list[float],
    end: tuple[np.ndarray, tuple[int, ...]],
    keep: int,
    closed: bool,
) -> None:
    """Levels below the first ``keep`` leave their residuals as they are.

    To 1e-3 with a projector that closes; to 0.1 m/s^2 with the default one, which is
    damped by 1e-3.
    """
    psi, levels = end
    config = HierarchyConfig()
    if closed:
        config = config._replace(projector_damping=1e-12)
    problem = situation_of(joints, speeds, offset)
    whole, _ = compiled_solution(problem, psi, config)
    part, _ = compiled_solution(problem, psi[:keep], config)
    np.testing.assert_allclose(
        level_residuals(problem[0], levels, whole)[:keep],
        level_residuals(problem[0], levels, part)[:keep],
        atol=1e-3 if closed else 0.1,
    )


@settings(max_examples=150, deadline=None)
@given(
    joints=joints,
    speeds=speeds,
    offset=offsets,
    share=st.floats(0, 1),
    literal=st.booleans(),
)
@example(  # where there is room, but for two of three solvers not
    joints=[0.54735, 0.26884, 0.86777, 0.19772, 0.0, 0.25, 0.0],
    speeds=[0.0] * 9,
    offset=[0.0] * 3,
    share=0.25,
    literal=False,
)
def test_compiled_form_equals_the_reference(
    joints: list[float],
    speeds: list[float],
    offset: list[float],
    share: float,
    literal: bool,
) -> None:
    """To 1e-4 of the accelerations, and to the number of levels, for any share.

    Limits that hardly leave room for each other may be infeasible to the reference's
    solvers only: there the compiled form's solution keeps them all.
    """
    config = HierarchyConfig()
    if literal:
        config = config._replace(rho=0.0, weighted=False)
    tasks, rows = situation_of(joints, speeds, offset)
    psi = priority_matrix(share)
    reference = solve_hierarchy(tasks, psi, rows, config, solve_by_daqp)
    if reference.failures:  # DAQP finds one in some thousands infeasible that is not
        reference = solve_hierarchy(tasks, psi, rows, config)
    u, counters = compiled_solution((tasks, rows), psi, config)
    assert counters[compiled.FAILURES] <= reference.failures
    if not reference.failures:
        assert counters[compiled.LEVELS] == reference.levels
        np.testing.assert_allclose(u, reference.acceleration, atol=1e-4)
    elif not counters[compiled.FAILURES]:
        used = rows.matrix @ u
        assert (rows.lower - 1e-6 <= used).all() and (used <= rows.upper + 1e-6).all()


@pytest.mark.parametrize("share", [0.0, 0.2, 0.7, 1.0])
def test_compiled_form_equals_the_reference_with_proxqp(
    situation: Draw, share: float
) -> None:
    config = HierarchyConfig()
    psi = priority_matrix(share)
    compared = qps = 0
    for tasks, rows in problems(situation, LIMITS, seed=11, count=60):
        reference = solve_hierarchy(tasks, psi, rows, config)
        if reference.failures:
            continue
        u, counters = compiled_solution((tasks, rows), psi, config)
        np.testing.assert_allclose(u, reference.acceleration, atol=1e-4)
        assert counters[compiled.LEVELS] == reference.levels
        compared += 1
        qps += reference.qps
    assert compared >= 50
    assert qps > 50


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.9, 1.0])
def test_solution_respects_every_limit(situation: Draw, share: float) -> None:
    psi = priority_matrix(share)
    for problem in problems(situation, LIMITS, seed=17, count=200):
        u, _ = compiled_solution(problem, psi, HierarchyConfig())
        rows = unit_rows(problem[1])
        assert (rows.matrix @ u <= rows.upper + 1e-6).all()
        assert (rows.matrix @ u >= rows.lower - 1e-6).all()


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_priorities_do_not_matter_to_tasks_that_agree(
    situation: Draw, share: float
) -> None:
    """One u meets all tasks, and no limit binds: it is the answer at any share."""
    config = HierarchyConfig(damping=1e-9, projector_damping=1e-9)
    rng = np.random.default_rng(23)
    for tasks, rows in problems(situation, LIMITS, seed=23, count=30):
        wanted = rng.normal(0, 0.3, 9)
        agreed = [replace(task, target=task.jacobian @ wanted) for task in tasks]
        problem = agreed, without_limits(rows)
        u, _ = compiled_solution(problem, priority_matrix(share), config)
        np.testing.assert_allclose(u, wanted, atol=1e-5)


def toy(psi: float, config: HierarchyConfig) -> float:
    """One variable of nine; A wants +1 and B wants -1, psi of A at the first level."""
    row = np.zeros((1, 9))
    row[0, 0] = 1.0
    tasks = [Task("A", row, np.array([1.0])), Task("B", row, np.array([-1.0]))]
    free = Bounds(np.zeros((1, 9)), np.array([-1.0]), np.array([1.0]))
    matrix = np.array([[psi, 1 - psi], [1.0, 1.0]])
    return float(solve_hierarchy(tasks, matrix, free, config).acceleration[0])


@pytest.mark.parametrize(
    ("psi", "expected"), [(0, -1), (0.1, -0.754), (0.5, 0), (0.9, 0.754), (1, 1)]
)
def test_fractional_priorities_blend(psi: float, expected: float) -> None:
    """By hand at 0.1: u1 = -0.8, P = 0.09, w = 3.6 and 2.8, x = 0.51."""
    config = HierarchyConfig(damping=1e-9, projector_damping=1e-9)
    assert toy(psi, config) == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("psi", [0.1, 0.5, 0.9])
def test_the_literal_recursion_does_not(psi: float) -> None:
    """Where the projector can be inverted, x undoes it: alpha has no effect."""
    config = HierarchyConfig(
        damping=1e-9, projector_damping=1e-9, rho=0.0, weighted=False
    )
    assert toy(psi, config) == pytest.approx(0, abs=2e-3)
