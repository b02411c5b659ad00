"""Each task's Jacobian and target, checked by finite differences and by hand."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from marl_mm.control.compiled.assembly import _write_rotation_error
from marl_mm.control.config import Gains
from marl_mm.control.records import Reference
from marl_mm.control.reference.tasks.arm_posture import arm_posture
from marl_mm.control.reference.tasks.base_orientation import base_orientation
from marl_mm.control.reference.tasks.base_velocity import base_velocity
from marl_mm.control.reference.tasks.manipulator_orientation import (
    manipulator_orientation,
    rotation_error,
)
from marl_mm.control.reference.tasks.manipulator_position import manipulator_position
from marl_mm.control.reference.tasks.task import Task
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.model import ACTUATED, ModelTerms, RobotModel, RobotState

Error = Callable[[np.ndarray, np.ndarray], np.ndarray]

Draw = Callable[[np.random.Generator], tuple[RobotState, ModelTerms, Reference]]
GAINS = Gains()
STEP = 1e-6


def moved(state: RobotState, velocity: np.ndarray, time: float) -> RobotState:
    """The state after moving at a constant velocity of the nine variables."""
    q, yaw = state.q, state.yaw
    turned, middle = yaw + time * velocity[1], yaw + time * velocity[1] / 2
    x = q[0] + time * velocity[0] * np.cos(middle)
    y = q[1] + time * velocity[0] * np.sin(middle)
    arm = q[4:] + time * velocity[2:]
    v = np.zeros(10)
    v[ACTUATED] = velocity
    return RobotState(np.array([x, y, np.cos(turned), np.sin(turned), *arm]), v)


def derivative(
    quantity: Callable[[RobotState], np.ndarray], state: RobotState, size: int
) -> np.ndarray:
    """Jacobian of a quantity by central differences in the nine variables."""
    columns = []
    for j in range(size):
        velocity = np.zeros(size)
        velocity[j] = 1.0
        ahead = quantity(moved(state, velocity, STEP))
        behind = quantity(moved(state, velocity, -STEP))
        columns.append((ahead - behind) / (2 * STEP))
    return np.stack(columns, axis=1)


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel(RobotConfig())


def position(model: RobotModel, state: RobotState) -> np.ndarray:
    return model.evaluate(state).position_w.copy()


def rotation(model: RobotModel, state: RobotState) -> np.ndarray:
    return np.ascontiguousarray(model.evaluate(state).rotation_w).copy()


def test_base_velocity_jacobian(situation: Draw) -> None:
    """Displacement along the present heading."""
    state, _, reference = situation(np.random.default_rng(0))
    heading = state.q[2:4].copy()
    numeric = derivative(lambda s: s.q[:2] @ heading[:, None], state, 9)
    task = base_velocity(state, reference, GAINS)
    np.testing.assert_allclose(task.jacobian, numeric, atol=1e-8)


def test_base_orientation_jacobian(situation: Draw) -> None:
    state, _, reference = situation(np.random.default_rng(1))
    numeric = derivative(lambda s: np.array([s.yaw]), state, 9)
    task = base_orientation(state, reference, GAINS)
    np.testing.assert_allclose(task.jacobian, numeric, atol=1e-8)


def test_manipulator_position_jacobian(situation: Draw, model: RobotModel) -> None:
    for seed in range(5):
        state, terms, reference = situation(np.random.default_rng(seed))
        numeric = derivative(lambda s: position(model, s), state, 9)
        task = manipulator_position(terms, reference, GAINS)
        np.testing.assert_allclose(task.jacobian, numeric, atol=1e-7)


def test_manipulator_orientation_jacobian(situation: Draw, model: RobotModel) -> None:
    for seed in range(5):
        state, terms, reference = situation(np.random.default_rng(seed))
        start = Rotation.from_matrix(rotation(model, state))

        def turned(s: RobotState, start: Rotation = start) -> np.ndarray:
            now = Rotation.from_matrix(rotation(model, s))
            vector: np.ndarray = (now * start.inv()).as_rotvec()
            return vector

        numeric = derivative(turned, state, 9)
        task = manipulator_orientation(terms, reference, GAINS)
        np.testing.assert_allclose(task.jacobian, numeric, atol=1e-7)


def test_arm_posture_jacobian(situation: Draw) -> None:
    state, _, reference = situation(np.random.default_rng(2))
    numeric = derivative(lambda s: s.q[4:], state, 9)
    task = arm_posture(state, reference, GAINS)
    np.testing.assert_allclose(task.jacobian, numeric, atol=1e-8)


def test_achieved_target_is_the_second_derivative_wanted(
    situation: Draw, model: RobotModel
) -> None:
    """If A u = b, the hand's acceleration J u + Jdot v equals the feedback."""
    state, terms, reference = situation(np.random.default_rng(3))
    task = manipulator_position(terms, reference, GAINS)
    u, *_ = np.linalg.lstsq(task.jacobian, task.target, rcond=None)
    error = reference.ee_position_w - terms.position_w
    rate = min(GAINS.ee_rate, GAINS.ee_speed / float(np.linalg.norm(error)))
    feedback = GAINS.ee_speed_rate * (rate * error - terms.velocity_w[:3])
    velocity = state.v[ACTUATED]
    ahead = (
        model.evaluate(moved(state, velocity + STEP * u, STEP)).velocity_w[:3].copy()
    )
    behind = model.evaluate(moved(state, velocity - STEP * u, -STEP)).velocity_w[:3]
    np.testing.assert_allclose((ahead - behind) / (2 * STEP), feedback, atol=1e-4)


def test_hand_speed_is_limited_far_from_the_target(situation: Draw) -> None:
    _, terms, reference = situation(np.random.default_rng(4))
    terms = terms._replace(velocity_w=np.zeros(6), bias_acceleration=np.zeros(6))
    far = reference._replace(ee_position_w=terms.position_w + np.array([3.0, 0, 0]))
    task = manipulator_position(terms, far, GAINS)
    wanted = task.target / GAINS.ee_speed_rate
    np.testing.assert_allclose(wanted, [GAINS.ee_speed, 0, 0], atol=1e-12)


def test_heading_error_takes_the_short_way_round(situation: Draw) -> None:
    state, _, reference = situation(np.random.default_rng(5))
    q = state.q.copy()
    q[2:4] = np.cos(3.1), np.sin(3.1)
    still = RobotState(q, np.zeros(10))
    task = base_orientation(still, reference._replace(base_heading=-3.1), GAINS)
    turn = 2 * np.pi - 6.2
    assert task.target[0] == pytest.approx(GAINS.heading_rate**2 * turn)


def compiled_error(rotation_w: np.ndarray, target_w: np.ndarray) -> np.ndarray:
    vector = np.empty(3)
    _write_rotation_error(rotation_w, target_w, vector)
    return vector


BOTH = pytest.mark.parametrize("error_of", [rotation_error, compiled_error])


@BOTH
@pytest.mark.parametrize(
    "angle", [0.0, 1e-5, 0.3, 1.5, 3.0, 3.09, 3.11, 3.14, -3.11, -3.14]
)
def test_rotation_error_is_the_rotation_vector(angle: float, error_of: Error) -> None:
    axis = np.array([0.6, -0.48, 0.64])
    start = Rotation.from_rotvec([0.3, -0.2, 0.9])
    target = Rotation.from_rotvec(angle * axis) * start
    error = error_of(start.as_matrix(), target.as_matrix())
    np.testing.assert_allclose(error, angle * axis, atol=1e-6)


@BOTH
@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0, -0.8]])
def test_rotation_error_at_half_a_turn_is_half_a_turn(
    axis: list[float], error_of: Error
) -> None:
    vector = np.pi * np.array(axis)
    error = error_of(np.eye(3), Rotation.from_rotvec(vector).as_matrix())
    assert min(abs(error - vector).max(), abs(error + vector).max()) < 1e-6


def test_tasks_at_their_goal_ask_for_nothing(situation: Draw) -> None:
    state, terms, reference = situation(np.random.default_rng(6))
    still = RobotState(state.q, np.zeros(10))
    terms = terms._replace(velocity_w=np.zeros(6), bias_acceleration=np.zeros(6))
    there = reference._replace(
        ee_position_w=terms.position_w,
        base_position_w=state.q[:2],
        base_heading=state.yaw,
        base_speed=0.0,
        posture=state.q[4:],
    )
    tasks: list[Task] = [
        base_velocity(still, there, GAINS),
        base_orientation(still, there, GAINS),
        manipulator_position(terms, there, GAINS),
        manipulator_orientation(terms, there, GAINS),
        arm_posture(still, there, GAINS),
    ]
    for task in tasks:
        np.testing.assert_allclose(task.target, 0, atol=1e-9, err_msg=task.name)
