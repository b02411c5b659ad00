"""The controller's promises at its edge: finite, bounded, refusing nonsense."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from marl_mm.control.config import (
    FORMS,
    SOLVERS,
    ControllerConfig,
    Form,
    Gains,
    HierarchyConfig,
    LimitConfig,
    Solver,
)
from marl_mm.control.limits import WHEEL_ARM
from marl_mm.control.records import Reference, Track
from marl_mm.control.wbc import WholeBodyController
from marl_mm.errors import NonFiniteStateError, UsageError
from marl_mm.robot.description import WHEEL_RADIUS, RobotConfig
from marl_mm.robot.limits import RobotLimits, robot_limits
from marl_mm.robot.model import ACTUATED, ModelTerms, RobotModel, RobotState

Draw = Callable[[np.random.Generator], tuple[RobotState, ModelTerms, Reference]]
LIMITS = robot_limits(RobotConfig())
MODEL = RobotModel(RobotConfig())


@pytest.mark.parametrize("solver", ["proxqp", "daqp"])
@pytest.mark.parametrize("form", FORMS)
def test_all_solvers_give_the_same_command(
    situation: Draw, limits: RobotLimits, form: Form, solver: Solver
) -> None:
    fast = WholeBodyController(limits, ControllerConfig(form=form))
    readable = WholeBodyController(limits, ControllerConfig(form=form, solver=solver))
    rng = np.random.default_rng(0)
    for alpha in (0.0, 0.25, 0.5, 0.99, 1.0):
        state, terms, reference = situation(rng)
        one = fast.tick(state, terms, reference, alpha)
        other = readable.tick(state, terms, reference, alpha)
        np.testing.assert_allclose(one.acceleration, other.acceleration, atol=1e-4)
        np.testing.assert_allclose(one.torque, other.torque, atol=1e-3)
        np.testing.assert_allclose(one.base_speed, other.base_speed, atol=1e-6)
        assert one.levels == other.levels


@pytest.mark.parametrize("solver", ["active-set", "proxqp"])
@pytest.mark.parametrize("zmp", [False, True])
@pytest.mark.parametrize("form", FORMS)
def test_commands_along_a_track_are_those_of_solve_to_the_last_bit(
    form: Form, zmp: bool, solver: Solver, limits: RobotLimits
) -> None:
    config = ControllerConfig(form=form, solver=solver, limits=LimitConfig(zmp=zmp))
    controller = WholeBodyController(limits, config)
    model, rng = RobotModel(RobotConfig(), balance=True), np.random.default_rng(4)
    for _ in range(100 if solver == "active-set" else 2):
        turn, joints = rng.uniform(-1, 1), rng.uniform(limits.lower, limits.upper)
        q = np.array([*rng.normal(size=2), np.cos(turn), np.sin(turn), *joints])
        state = RobotState(q, rng.normal(size=10))
        terms = model.evaluate(state)
        target_w, points = (
            terms.position_w + rng.normal(0, 0.1, 3),
            rng.normal(0, 1, (3, 2)),
        )
        rotation_w = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        track = Track(
            target_w, rotation_w, points, 0.5, 0.3, -1.0, 0.1, rng.normal(size=7)
        )
        priorities = controller.priorities(rng.uniform())
        command = controller.along(track, priorities)(2, state, terms)
        expected = controller.solve(state, terms, track(2, state), priorities)
        for name, value in command._asdict().items():
            np.testing.assert_array_equal(value, getattr(expected, name), name)


def test_a_track_that_ends_before_its_step_is_refused(
    situation: Draw, limits: RobotLimits
) -> None:
    state, terms, reference = situation(np.random.default_rng(0))
    (target_w, rotation_w, point, _, speed, posture) = reference
    track = Track(target_w, rotation_w, point[None], 0.5, 0.3, 1.0, speed, posture)
    controller = WholeBodyController(limits, ControllerConfig())
    command_at = controller.along(track, controller.priorities(0.5))
    assert command_at(0, state, terms).failures == 0
    with pytest.raises(UsageError, match="fewer points"):
        command_at(1, state, terms)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("target_w", np.zeros(2)),
        ("rotation_w", np.eye(3)[:2]),
        ("points", np.zeros((240, 3))),
        ("posture", np.zeros(6)),
        ("matrices", np.zeros((4, 5))),
    ],
)
def test_arrays_of_another_shape_are_refused(
    field: str, value: Any, situation: Draw, limits: RobotLimits
) -> None:
    """Compiled code would read what lies behind them."""
    _, _, reference = situation(np.random.default_rng(0))
    (target_w, rotation_w, point, _, speed, posture) = reference
    track = Track(target_w, rotation_w, point[None], 0.5, 0.3, 1.0, speed, posture)
    controller = WholeBodyController(limits, ControllerConfig())
    priorities = controller.priorities(0.5)
    if field in track._fields:
        track = track._replace(**{field: value})
    else:
        priorities = priorities._replace(**{field: value})
    with pytest.raises(UsageError, match=f"{field} has shape"):
        controller.along(track, priorities)


@pytest.mark.parametrize("solver", SOLVERS)
def test_solve_refuses_arrays_of_another_shape(
    situation: Draw, limits: RobotLimits, solver: Solver
) -> None:
    state, terms, reference = situation(np.random.default_rng(0))
    controller = WholeBodyController(limits, ControllerConfig(solver=solver))
    both = controller.priorities(0.5)
    for wrong in (
        (state, reference._replace(posture=np.zeros(6)), both),
        (state._replace(q=state.q[:7]), reference, both),
        (state, reference, both._replace(shares=both.shares[:1])),
        (state, reference, both._replace(matrices=both.matrices[..., :4])),
    ):
        with pytest.raises(UsageError, match="has shape"):
            controller.solve(wrong[0], terms, *wrong[1:])


def test_lists_are_taken_as_arrays(situation: Draw, limits: RobotLimits) -> None:
    state, terms, reference = situation(np.random.default_rng(0))
    controller = WholeBodyController(limits, ControllerConfig())
    lists = reference._replace(posture=reference.posture.tolist())
    expected, found = (
        controller.tick(state, terms, each, 0.5).torque for each in (reference, lists)
    )
    np.testing.assert_array_equal(found, expected)


def test_blend_is_the_mix_of_the_two_ends(situation: Draw, limits: RobotLimits) -> None:
    controller = WholeBodyController(limits, ControllerConfig())
    state, terms, reference = situation(np.random.default_rng(1))
    stable, reaching, mixed = (
        controller.tick(state, terms, reference, alpha).acceleration
        for alpha in (1.0, 0.0, 0.3)
    )
    share = 1 - 0.7**2
    expected = share * stable + (1 - share) * reaching
    np.testing.assert_allclose(mixed, expected, atol=1e-12)


@pytest.mark.parametrize("form", ["blend", "rhp"])
@pytest.mark.parametrize("end", [0.0, 1.0])
def test_alpha_reaches_its_ends_continuously(
    situation: Draw, limits: RobotLimits, form: Form, end: float
) -> None:
    """The worst gap to the end over 200 states shrinks at 1e-3, 1e-5, 1e-7."""
    controller = WholeBodyController(limits, ControllerConfig(form=form))
    rng = np.random.default_rng(2)
    gaps = np.zeros((200, 3))
    for i in range(len(gaps)):
        drawn = situation(rng)
        exact = controller.tick(*drawn, end).acceleration
        for j, distance in enumerate((1e-3, 1e-5, 1e-7)):
            near = controller.tick(*drawn, abs(end - distance)).acceleration
            gaps[i, j] = np.abs(near - exact).max()
    worst, typical = gaps.max(axis=0), np.median(gaps, axis=0)
    assert worst[1] < worst[0] / 5
    assert worst[2] < worst[1] / 5 + 1e-9
    assert typical[1] < typical[0] / 5
    assert worst[2] < 0.05


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_the_literal_form_jumps_at_its_ends(
    situation: Draw, limits: RobotLimits, end: float
) -> None:
    """Which is why it is not used: 1e-7 of alpha moves an acceleration by over 1."""
    controller = WholeBodyController(limits, ControllerConfig(form="rhp-literal"))
    rng = np.random.default_rng(2)
    gaps = []
    for _ in range(50):
        drawn = situation(rng)
        exact = controller.tick(*drawn, end).acceleration
        near = controller.tick(*drawn, abs(end - 1e-7)).acceleration
        gaps.append(np.abs(near - exact).max())
    assert max(gaps) > 1


@settings(max_examples=200, deadline=None)
@given(
    joints=st.lists(st.floats(-4, 4), min_size=7, max_size=7),
    velocity=st.lists(st.floats(-8, 8), min_size=10, max_size=10),
    target=st.lists(st.floats(-50, 50), min_size=3, max_size=3),
    alpha=st.floats(0, 1),
    form=st.sampled_from(FORMS),
)
def test_any_finite_state_gives_a_finite_bounded_command(
    joints: list[float],
    velocity: list[float],
    target: list[float],
    alpha: float,
    form: Form,
) -> None:
    """Far outside what the robot can do, where the limits contradict each other."""
    controller = WholeBodyController(LIMITS, ControllerConfig(form=form))
    state = RobotState(np.array([0.3, -0.2, 0.6, 0.8, *joints]), np.array(velocity))
    reference = Reference(
        np.array(target), np.eye(3), np.array([9.0, 9.0]), 3.0, 1.0, np.zeros(7)
    )
    command = controller.tick(state, MODEL.evaluate(state), reference, alpha)
    assert np.isfinite(command.acceleration).all()
    assert (np.abs(command.torque) <= LIMITS.torque).all()
    assert (np.abs(command.acceleration) <= LIMITS.acceleration + 2e-2).all()


def overloaded(terms: ModelTerms, joint: int) -> ModelTerms:
    """A load of 200 N m on one joint: no acceleration keeps its torque limit."""
    nonlinear = terms.nonlinear.copy()
    nonlinear[3 + joint] += 200.0
    return terms._replace(nonlinear=nonlinear)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("joint", [0, 6])
def test_where_limits_contradict_each_other_it_brakes_and_says_why(
    situation: Draw, limits: RobotLimits, form: Form, solver: Solver, joint: int
) -> None:
    state, terms, reference = situation(np.random.default_rng(7))
    loaded = overloaded(terms, joint)
    controller = WholeBodyController(limits, ControllerConfig(form=form, solver=solver))
    command = controller.tick(state, loaded, reference, 0.5)
    assert command.safe
    assert command.failures > 0
    assert command.reason is not None
    assert f"torque of arm joint {joint + 1}: out of reach" in command.reason
    velocity = state.v[ACTUATED]
    others = [i for i in range(7) if i != joint]
    needed = loaded.mass_matrix[3:, ACTUATED] @ command.acceleration
    needed += loaded.nonlinear[3:]
    assert (np.abs(needed)[others] <= limits.torque[others] + 1e-6).all()
    braking = np.sign(velocity) * command.acceleration
    assert (braking <= 1e-3).all(), "nothing speeds up"
    assert (np.abs(command.acceleration) <= limits.acceleration + 1e-3).all()
    assert abs(command.torque[joint]) == pytest.approx(limits.torque[joint])
    expected = np.clip(needed, -limits.torque, limits.torque)
    np.testing.assert_allclose(command.torque, expected, atol=1e-9)


def test_two_solvers_brake_alike(situation: Draw, limits: RobotLimits) -> None:
    rng = np.random.default_rng(10)
    for _ in range(20):
        state, terms, reference = situation(rng)
        loaded = overloaded(terms, int(rng.integers(7)))
        one, other = (
            WholeBodyController(limits, ControllerConfig(solver=solver)).tick(
                state, loaded, reference, 0.5
            )
            for solver in ("active-set", "daqp")
        )
        assert one.safe and other.safe
        np.testing.assert_allclose(one.acceleration, other.acceleration, atol=1e-9)
        assert one.reason == other.reason


def test_an_ordinary_command_has_no_reason(
    situation: Draw, limits: RobotLimits
) -> None:
    controller = WholeBodyController(limits, ControllerConfig())
    command = controller.tick(*situation(np.random.default_rng(7)), 0.5)
    assert not command.safe
    assert command.reason is None


def test_running_out_of_iterations_is_a_reason_of_its_own(
    situation: Draw, limits: RobotLimits
) -> None:
    config = ControllerConfig(hierarchy=HierarchyConfig(iterations=1))
    controller = WholeBodyController(limits, config)
    rng = np.random.default_rng(8)
    reasons = {controller.tick(*situation(rng), 0.0).reason for _ in range(20)}
    assert "the QP ran out of iterations" in reasons


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_nan_in_state_or_terms_is_an_error_with_the_state(
    limits: RobotLimits, solver: Solver, situation: Draw
) -> None:
    controller = WholeBodyController(limits, ControllerConfig(solver=solver))
    state, terms, reference = situation(np.random.default_rng(3))
    for broken in (
        (state, terms._replace(nonlinear=np.full(10, np.nan))),
        (state._replace(q=np.full(11, np.nan)), terms),
    ):
        with pytest.raises(NonFiniteStateError, match="no finite command at q = "):
            controller.tick(*broken, reference, 0.5)


@pytest.mark.parametrize("alpha", [-0.1, 1.1, float("nan")])
def test_alpha_outside_its_range_is_refused(
    situation: Draw, limits: RobotLimits, alpha: float
) -> None:
    controller = WholeBodyController(limits, ControllerConfig())
    with pytest.raises(UsageError, match="alpha"):
        controller.tick(*situation(np.random.default_rng(4)), alpha)


def test_the_zmp_limit_needs_a_model_that_knows_of_it(
    situation: Draw, limits: RobotLimits
) -> None:
    config = ControllerConfig(limits=LimitConfig(zmp=True))
    controller = WholeBodyController(limits, config)
    with pytest.raises(UsageError, match="balance=True"):
        controller.tick(*situation(np.random.default_rng(9)), 0.5)


@pytest.mark.parametrize(
    "wrong",
    [
        {"limits": LimitConfig(traction=-5.0)},
        {"limits": LimitConfig(horizon=0.0)},
        {"hierarchy": HierarchyConfig(projector_damping=0.0)},
    ],
)
def test_numbers_that_cannot_be_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="expected > 0"):
        ControllerConfig(**wrong)


def test_a_solver_that_is_not_installed_is_refused(
    limits: RobotLimits, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("marl_mm.control.wbc.find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"pip install .*bench"):
        WholeBodyController(limits, ControllerConfig(solver="daqp"))


@pytest.mark.parametrize("response", [0.5, 11.0])
def test_an_odd_response_is_refused(response: float) -> None:
    with pytest.raises(UsageError, match="response is"):
        ControllerConfig(response=response)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UsageError, match="'active-set', 'proxqp', 'daqp'"):
        ControllerConfig(solver="osqp")  # type: ignore[arg-type]


def test_integer_gains_mean_the_same(situation: Draw, limits: RobotLimits) -> None:
    whole = ControllerConfig(gains=Gains(ee_rate=5, ee_speed_rate=12))
    situation_ = situation(np.random.default_rng(5))
    one = WholeBodyController(limits, whole).tick(*situation_, 0.5)
    other = WholeBodyController(limits, ControllerConfig()).tick(*situation_, 0.5)
    np.testing.assert_array_equal(one.acceleration, other.acceleration)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_joint_that_carries_all_it_can_makes_the_others_brake_gently(
    situation: Draw, limits: RobotLimits, solver: Solver
) -> None:
    """Half a newton metre is left to the second joint, on one side."""
    controller = WholeBodyController(limits, ControllerConfig(solver=solver))
    rng, gentle = np.random.default_rng(11), 0
    for side in (-1, 1) * 5:
        state, terms, reference = situation(rng)
        loaded = overloaded(terms, 6)
        loaded.nonlinear[4] = side * (limits.torque[1] - 0.5)
        command = controller.tick(state, loaded, reference, 0.5)
        assert command.safe
        needed = loaded.mass_matrix[4, ACTUATED] @ command.acceleration
        needed += loaded.nonlinear[4]
        assert abs(needed) <= limits.torque[1] + 1e-6
        gentle += abs(needed) > limits.torque[1] - 1e-6
    assert gentle > 0


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_command_of_the_base_asks_for_more_than_the_wheels_speed(
    situation: Draw, limits: RobotLimits, solver: Solver
) -> None:
    controller = WholeBodyController(limits, ControllerConfig(solver=solver))
    rng = np.random.default_rng(12)
    for _ in range(5):
        state, terms, reference = situation(rng)
        state.v[0], state.v[2] = limits.speed[:2]
        forward, turning = controller.tick(state, terms, reference, 0.5).base_speed
        rim = abs(forward) + WHEEL_ARM * abs(turning)
        assert rim <= limits.wheel_speed * WHEEL_RADIUS + 1e-9
