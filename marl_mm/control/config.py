"""The controller's numbers: gains, solver, limits' shape.

Defaults are those that held in closed loop over 2,000 episodes of a prototype with the
same mathematics: 8 goals, 11 alphas, 24 variations, without one failed level.
"""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from marl_mm.errors import UsageError

Form = Literal["blend", "rhp"]
"""How alpha enters: blend of two strict hierarchies, or one fractional hierarchy."""

Solver = Literal["active-set", "proxqp"]
"""Compiled controller, or the readable reference with ProxQP."""


DEPENDENT = 1e-10
"""A row whose rest after Gram-Schmidt has a smaller squared norm is dropped."""


class Gains(NamedTuple):
    """Feedback rates of the tasks."""

    ee_rate: float = 5.0
    """End-effector position error to speed [1/s]."""

    ee_speed: float = 0.5
    """Largest speed wanted of the end-effector [m/s]."""

    ee_speed_rate: float = 12.0
    """End-effector speed error to acceleration [1/s]."""

    ee_rotation_rate: float = 6.0
    """End-effector orientation, critically damped [rad/s]."""

    base_rate: float = 2.0
    """Base distance behind its plan to speed [1/s]."""

    base_catch: float = 0.3
    """Largest speed added to catch up with the plan [m/s]."""

    base_speed_rate: float = 6.0
    """Base speed error to acceleration [1/s]."""

    heading_rate: float = 4.0
    """Heading, critically damped [rad/s]."""

    posture_rate: float = 2.5
    """Arm posture, critically damped [rad/s]."""


class HierarchyConfig(NamedTuple):
    """Numbers of the recursion over levels."""

    damping: float = 1e-3
    """eps: weight of |x|^2 in every level."""

    projector_damping: float = 1e-3
    """A row of squared norm n^2 is projected out by n^2 / (n^2 + this)."""

    rho: float = 1.0
    """Weight of |x|^2 - |P x|^2 from the second level on (fractional form)."""

    margin: float = 1e-8
    """Levels below the first contain x = 0 with this to spare."""

    tolerance: float = 1e-9
    """A closed-form level this far outside a limit still counts as inside."""

    iterations: int = 100
    """Most steps of a level's QP (active-set; ProxQP has its own cap)."""


class LimitConfig(NamedTuple):
    """Shape of the limits on acceleration."""

    horizon: float = 4 / 240
    """Time in which a velocity limit may be reached [s]."""

    joint_margin: float = 0.01
    """The braking bound stops this far before a joint's limit [rad]."""

    keep_out: float = 0.45
    """The end-effector stays this far ahead of the base's origin [m]."""

    keep_out_rate: float = 8.0
    """Of the exponential barrier in front of the keep-out plane [1/s]."""

    keep_out_acceleration: float = 8.0
    """Most the barrier may ask for [m/s^2]."""


@dataclass(frozen=True)
class ControllerConfig:
    """Everything the whole-body controller can be told."""

    form: Form = "blend"
    """"blend" mixes the two strict hierarchies; "rhp" is the fractional hierarchy."""

    solver: Solver = "active-set"
    """"active-set" is compiled. "proxqp" is the readable reference: 20 times slower
    and, in closed loop, not reproducible to the last bit."""

    gains: Gains = field(default_factory=Gains)

    hierarchy: HierarchyConfig = field(default_factory=HierarchyConfig)

    limits: LimitConfig = field(default_factory=LimitConfig)

    def __post_init__(self) -> None:
        for name, value, choices in (
            ("form", self.form, ("blend", "rhp")),
            ("solver", self.solver, ("active-set", "proxqp")),
        ):
            if value not in choices:
                raise UsageError(
                    f"controller {name} is {value!r}, expected one of {choices}"
                )
