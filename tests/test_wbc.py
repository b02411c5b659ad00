"""The controller's promises at its edge: finite, bounded, refusing nonsense."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from marl_mm.control.config import FORMS, ControllerConfig, Form, Gains, Solver
from marl_mm.control.tasks.task import Reference
from marl_mm.control.wbc import WholeBodyController
from marl_mm.envs.core import ReachCore
from marl_mm.errors import NonFiniteStateError, UsageError
from marl_mm.robot.description import RobotConfig
from marl_mm.robot.limits import RobotLimits, robot_limits
from marl_mm.robot.model import ModelTerms, RobotModel, RobotState

Draw = Callable[[np.random.Generator], tuple[RobotState, ModelTerms, Reference]]
LIMITS = robot_limits(RobotConfig())
MODEL = RobotModel(RobotConfig())


@pytest.mark.parametrize("form", FORMS)
def test_both_solvers_give_the_same_command(
    situation: Draw, limits: RobotLimits, form: Form
) -> None:
    fast = WholeBodyController(limits, ControllerConfig(form=form))
    readable = WholeBodyController(limits, ControllerConfig(form=form, solver="proxqp"))
    rng = np.random.default_rng(0)
    for alpha in (0.0, 0.25, 0.5, 0.99, 1.0):
        state, terms, reference = situation(rng)
        one = fast.tick(state, terms, reference, alpha)
        other = readable.tick(state, terms, reference, alpha)
        np.testing.assert_allclose(one.acceleration, other.acceleration, atol=1e-4)
        np.testing.assert_allclose(one.torque, other.torque, atol=1e-3)
        assert one.levels == other.levels


def test_blend_is_the_mix_of_the_two_ends(situation: Draw, limits: RobotLimits) -> None:
    controller = WholeBodyController(limits, ControllerConfig())
    state, terms, reference = situation(np.random.default_rng(1))
    stable, reaching, mixed = (
        controller.tick(state, terms, reference, alpha).acceleration
        for alpha in (1.0, 0.0, 0.3)
    )
    np.testing.assert_allclose(mixed, 0.3 * stable + 0.7 * reaching, atol=1e-12)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("end", [0.0, 1.0])
def test_alpha_reaches_its_ends_continuously(
    situation: Draw, limits: RobotLimits, form: Form, end: float
) -> None:
    controller = WholeBodyController(limits, ControllerConfig(form=form))
    state, terms, reference = situation(np.random.default_rng(2))
    exact = controller.tick(state, terms, reference, end).acceleration
    gaps = []
    for distance in (1e-2, 1e-4):
        near = controller.tick(state, terms, reference, abs(end - distance))
        gaps.append(np.abs(near.acceleration - exact).max())
    assert gaps[1] < gaps[0] / 10 + 1e-9


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


@pytest.mark.parametrize("solver", ["active-set", "proxqp"])
def test_infeasible_limits_are_counted_and_survived(
    situation: Draw, limits: RobotLimits, solver: Solver
) -> None:
    """A load of 500 N m on every joint: no acceleration keeps the torque limits."""
    state, terms, reference = situation(np.random.default_rng(7))
    loaded = terms._replace(nonlinear=np.full(10, 500.0))
    controller = WholeBodyController(limits, ControllerConfig(solver=solver))
    command = controller.tick(state, loaded, reference, 1.0)
    assert command.failures > 0
    assert np.isfinite(command.acceleration).all()
    assert (np.abs(command.acceleration) <= limits.acceleration + 1e-3).all()
    np.testing.assert_allclose(command.torque, limits.torque)  # all it can give


@pytest.mark.parametrize("solver", ["active-set", "proxqp"])
def test_a_nan_in_the_state_is_an_error_with_the_state(
    limits: RobotLimits, solver: Solver, situation: Draw
) -> None:
    controller = WholeBodyController(limits, ControllerConfig(solver=solver))
    state, terms, reference = situation(np.random.default_rng(3))
    broken = terms._replace(nonlinear=np.full(10, np.nan))
    with pytest.raises(NonFiniteStateError, match="no finite command at q = "):
        controller.tick(state, broken, reference, 0.5)


@pytest.mark.parametrize("alpha", [-0.1, 1.1, float("nan")])
def test_alpha_outside_its_range_is_refused(
    situation: Draw, limits: RobotLimits, alpha: float
) -> None:
    controller = WholeBodyController(limits, ControllerConfig())
    with pytest.raises(UsageError, match="alpha"):
        controller.tick(*situation(np.random.default_rng(4)), alpha)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UsageError, match="'active-set', 'proxqp'"):
        ControllerConfig(solver="osqp")  # type: ignore[arg-type]


def test_integer_gains_mean_the_same(situation: Draw, limits: RobotLimits) -> None:
    whole = ControllerConfig(gains=Gains(ee_rate=5, ee_speed_rate=12))
    situation_ = situation(np.random.default_rng(5))
    one = WholeBodyController(limits, whole).tick(*situation_, 0.5)
    other = WholeBodyController(limits, ControllerConfig()).tick(*situation_, 0.5)
    np.testing.assert_array_equal(one.acceleration, other.acceleration)


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_a_minute_of_abuse_in_closed_loop(form: Form) -> None:
    """Random targets and alphas, 60 s of 240 Hz: no failed level, limits kept."""
    from marl_mm.envs.config import reach_config

    core = ReachCore(reach_config("Reach-v0", {"controller": {"form": form}}))
    rng = np.random.default_rng(6)
    failures = 0
    for _ in range(4):
        core.reset(rng)
        drift = rng.uniform(-0.1, 0.1, 3)  # runs to the edge of the work space
        for _ in range(15):
            delta = 10 * (drift + rng.uniform(-0.1, 0.1, 3))
            alpha = rng.choice([0.0, 1.0, rng.uniform()])
            step = core.step(np.array([*delta, alpha]))
            failures += step.info["qp_failures"]
            arm = core.drive.world.read().q[4:]
            assert (arm > LIMITS.lower).all()
            assert (arm < LIMITS.upper).all()
            assert step.info["zmp_margin"] > 0
    core.close()
    assert failures == 0
