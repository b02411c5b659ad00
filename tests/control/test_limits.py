"""Limits as rows: never empty, and equal to hand-computed cases."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from marl_mm.control.compiled.assembly import assemble_limits
from marl_mm.control.config import LimitConfig
from marl_mm.control.limits import (
    BOX_ROWS,
    KEEP_OUT,
    LIMIT_NAMES,
    TORQUE_ROWS,
    row_count,
)
from marl_mm.control.records import Reference
from marl_mm.control.reference.limits import (
    acceleration_box,
    bounds,
    edge_moments,
    keep_out_bias,
    keep_out_bound,
    keep_out_direction,
    wheel_forces,
    wheel_rims,
)
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.limits import RobotLimits, robot_limits
from marl_mm.robot.model import ACTUATED, ModelTerms, RobotModel, RobotState
from marl_mm.robot.support import SUPPORT_B, SUPPORT_INWARD_B, support_margin

Draw = Callable[[np.random.Generator], tuple[RobotState, ModelTerms, Reference]]
CONFIG = LimitConfig()
ROBOT = robot_limits(RobotConfig())
MODEL = RobotModel(RobotConfig())


def at(arm: np.ndarray, velocity: np.ndarray) -> RobotState:
    v = np.zeros(10)
    v[ACTUATED] = velocity
    return RobotState(np.array([0, 0, 1, 0, *arm]), v)


@settings(max_examples=300, deadline=None)
@given(
    joints=st.lists(st.floats(-4, 4), min_size=7, max_size=7),
    velocity=st.lists(st.floats(-30, 30), min_size=9, max_size=9),
)
def test_box_is_never_empty(joints: list[float], velocity: list[float]) -> None:
    state = at(np.array(joints), np.array(velocity))
    lower, upper = acceleration_box(state, ROBOT, CONFIG)
    assert (upper - lower >= 1.9e-3).all()
    assert (lower >= -ROBOT.acceleration - 2e-3).all()
    assert (upper <= ROBOT.acceleration + 2e-3).all()


def test_box_in_the_middle_is_the_acceleration_limit() -> None:
    middle = (ROBOT.lower + ROBOT.upper) / 2
    lower, upper = acceleration_box(at(middle, np.zeros(9)), ROBOT, CONFIG)
    np.testing.assert_allclose(upper, ROBOT.acceleration)
    np.testing.assert_allclose(lower, -ROBOT.acceleration)


def test_at_full_speed_only_braking_is_left() -> None:
    middle = (ROBOT.lower + ROBOT.upper) / 2
    fastest = CONFIG.speed_share * ROBOT.speed
    _, upper = acceleration_box(at(middle, fastest), ROBOT, CONFIG)
    np.testing.assert_allclose(upper, 0, atol=1e-9)


def test_beyond_a_joint_limit_the_box_pushes_back() -> None:
    _, upper = acceleration_box(at(ROBOT.upper, np.zeros(9)), ROBOT, CONFIG)
    assert (upper[2:] <= 1e-9).all()
    moving = np.array([0.0, 0.0, *np.full(7, 0.5)])
    _, upper = acceleration_box(at(ROBOT.upper, moving), ROBOT, CONFIG)
    assert (upper[2:] < -7).all()


def test_torque_rows_bound_the_torque(situation: Draw, limits: RobotLimits) -> None:
    """C u <= d_bar exactly where M u + h reaches the torque limit."""
    state, terms, _ = situation(np.random.default_rng(0))
    rows = bounds(state, terms, limits, CONFIG)
    u = np.random.default_rng(1).normal(size=9)
    full = np.zeros(10)
    full[ACTUATED] = u
    torque = (terms.mass_matrix @ full + terms.nonlinear)[3:]
    slack = rows.upper[TORQUE_ROWS] - rows.matrix[TORQUE_ROWS] @ u
    np.testing.assert_allclose(slack, limits.torque - torque, atol=1e-9)


def test_box_rows_select_the_variables(situation: Draw, limits: RobotLimits) -> None:
    state, terms, _ = situation(np.random.default_rng(2))
    rows = bounds(state, terms, limits, CONFIG)
    np.testing.assert_array_equal(rows.matrix[BOX_ROWS], np.eye(9))


def test_keep_out_barrier_by_hand(situation: Draw, limits: RobotLimits) -> None:
    """At rest 0.02 m inside the plane: x'' >= 8^2 * 0.02."""
    state, terms, _ = situation(np.random.default_rng(3))
    state = RobotState(np.array([0, 0, 1.0, 0, *state.q[4:]]), np.zeros(10))
    terms = terms._replace(
        position_w=np.array([CONFIG.keep_out - 0.02, 0.1, 0.6]),
        bias_acceleration=np.zeros(6),
    )
    assert keep_out_bound(state, terms, CONFIG) == pytest.approx(64 * 0.02)


def test_keep_out_row_and_bias_are_derivatives(limits: RobotLimits) -> None:
    """x' and x'' of the distance ahead, by finite differences of a turning robot."""
    model = RobotModel(RobotConfig())
    rng = np.random.default_rng(5)
    step = 1e-5
    for _ in range(10):
        velocity = np.array([*rng.uniform(-0.5, 0.5, 1), *rng.uniform(-1.5, 1.5, 8)])
        aside = rng.uniform(-0.2, 0.2)  # of a base that slips
        joints = np.array(RobotConfig().initial_joints) + rng.normal(0, 0.3, 7)
        yaw = rng.uniform(-3, 3)

        def ahead_at(
            time: float,
            yaw: float = yaw,
            joints: np.ndarray = joints,
            velocity: np.ndarray = velocity,
            aside: float = aside,
        ) -> tuple[float, RobotState, ModelTerms]:
            turned, middle = yaw + time * velocity[1], yaw + time * velocity[1] / 2
            cos, sin = np.cos(middle), np.sin(middle)
            way = time * np.array([[cos, -sin], [sin, cos]]) @ [velocity[0], aside]
            arm = joints + time * velocity[2:]
            v = np.zeros(10)
            v[ACTUATED], v[1] = velocity, aside
            q = np.array([*way, np.cos(turned), np.sin(turned), *arm])
            state = RobotState(q, v)
            terms = model.evaluate(state)
            terms = ModelTerms(*(array.copy(order="K") for array in terms))
            return float(q[2:4] @ (terms.position_w[:2] - q[:2])), state, terms

        before, now, after = ahead_at(-step), ahead_at(0.0), ahead_at(step)
        speed = keep_out_direction(now[1], now[2]) @ velocity
        assert speed == pytest.approx((after[0] - before[0]) / (2 * step), abs=1e-7)
        acceleration = (after[0] - 2 * now[0] + before[0]) / step**2
        assert keep_out_bias(now[1], now[2]) == pytest.approx(acceleration, abs=1e-4)


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 10_000), depth=st.floats(-3, 3))
def test_keep_out_asks_for_no_more_than_the_box_gives(seed: int, depth: float) -> None:
    rng = np.random.default_rng(seed)
    joints = rng.uniform(ROBOT.lower, ROBOT.upper)
    state = at(joints, rng.normal(0, 1, 9))
    terms = MODEL.evaluate(state)
    terms = terms._replace(position_w=terms.position_w + np.array([depth, 0, 0]))
    rows = bounds(state, terms, ROBOT, CONFIG)
    row = rows.matrix[KEEP_OUT]
    best = np.where(row > 0, row * rows.upper[BOX_ROWS], row * rows.lower[BOX_ROWS])
    assert rows.lower[KEEP_OUT] < best.sum()


def test_keep_out_moves_the_arm_not_the_base(
    situation: Draw, limits: RobotLimits
) -> None:
    state, terms, _ = situation(np.random.default_rng(4))
    rows = bounds(state, terms, limits, CONFIG)
    assert (rows.matrix[KEEP_OUT, :2] == 0).all()
    assert rows.lower[KEEP_OUT] < rows.upper[KEEP_OUT]


def test_wheel_rows_are_the_rims_accelerations() -> None:
    """Forward and turning left, the right rim is faster by the wheels' distance."""
    middle = (ROBOT.lower + ROBOT.upper) / 2
    state = at(middle, np.array([0.5, 1.0, *np.zeros(7)]))
    rows, lower, upper = wheel_rims(state, ROBOT, CONFIG)
    left, right = 0.5 - 0.2226, 0.5 + 0.2226
    most = 0.98 * 20 * 0.0625
    np.testing.assert_allclose(rows[:, :2], [[1, -0.2226], [1, 0.2226]])
    np.testing.assert_allclose(upper * CONFIG.horizon, [most - left, most - right])
    np.testing.assert_allclose(lower * CONFIG.horizon, [-most - left, -most - right])


def test_wheel_forces_are_what_moves_the_base(situation: Draw) -> None:
    """Their sum, couple and side force are the base's rows of M u + h."""
    _, terms, _ = situation(np.random.default_rng(6))
    u = np.random.default_rng(7).normal(size=9)
    rows, bias = wheel_forces(terms)
    left, right, across = rows @ u + bias
    full = np.zeros(10)
    full[ACTUATED] = u
    force = terms.mass_matrix @ full + terms.nonlinear
    assert left + right == pytest.approx(force[0])
    assert (right - left) * 0.2226 == pytest.approx(force[2])
    assert across == pytest.approx(force[1])


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_edge_moments_are_distances_of_the_zero_moment_point(seed: int) -> None:
    """Moment over vertical force is the point's distance to each edge, less the margin.

    The point itself comes from another function of Pinocchio.
    """
    rng = np.random.default_rng(seed)
    arm = rng.uniform(ROBOT.lower, ROBOT.upper)
    yaw = rng.uniform(-3, 3)
    v = np.zeros(10)
    v[ACTUATED] = rng.normal(0, 0.5, 9)
    state = RobotState(np.array([0.3, -0.2, np.cos(yaw), np.sin(yaw), *arm]), v)
    u = rng.normal(0, 2, 9)
    model = RobotModel(RobotConfig(), balance=True)
    terms = model.evaluate(state)
    config = LimitConfig(zmp=True, zmp_margin=0.05)
    rows, lower = edge_moments(state, terms, config)
    vertical = terms.wrench[2, ACTUATED] @ u + terms.wrench[2, -1]
    distances = (rows @ u - lower) / vertical + config.zmp_margin
    point = model.zmp_b(state, u)
    expected = ((point - SUPPORT_B) * SUPPORT_INWARD_B).sum(axis=1)
    np.testing.assert_allclose(distances, expected, atol=1e-9)
    assert distances.min() == pytest.approx(support_margin(point))


@settings(max_examples=200, deadline=None)
@given(
    joints=st.lists(st.floats(-4, 4), min_size=7, max_size=7),
    velocity=st.lists(st.floats(-8, 8), min_size=10, max_size=10),
    zmp=st.booleans(),
)
def test_compiled_rows_are_the_readable_ones(
    joints: list[float], velocity: list[float], zmp: bool
) -> None:
    config = LimitConfig(zmp=zmp)
    state = RobotState(np.array([0.3, -0.2, 0.6, 0.8, *joints]), np.array(velocity))
    model = RobotModel(RobotConfig(), balance=zmp)
    terms = model.evaluate(state)
    expected = bounds(state, terms, ROBOT, config)
    rows = row_count(config)
    assert len(LIMIT_NAMES[:rows]) == rows == len(expected.lower)
    matrix, lower, upper = np.zeros((rows, 9)), np.zeros(rows), np.zeros(rows)
    assemble_limits(state, terms, ROBOT, config, matrix, lower, upper)
    np.testing.assert_allclose(matrix, expected.matrix, atol=1e-9)
    np.testing.assert_allclose(lower, expected.lower, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(upper, expected.upper, rtol=1e-9, atol=1e-8)
