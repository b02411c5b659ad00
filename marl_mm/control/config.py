"""The controller's numbers: gains, solver, limits' shape.

Gains and damping are those that held in closed loop over 2,000 episodes of a prototype
(8 goals, 11 alphas, 24 variations, without one failed level); what was added since says
why. ``marl-mm bench abuse`` and ``sweep-alpha`` measure them.
"""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

from marl_mm.declared import check_not_negative, check_positive, make_like_defaults
from marl_mm.errors import UsageError

Knowledge = Literal["estimated", "given", "none"]
"""Source of the load's mass: estimate from the joints' torques, given at the start, or
none."""

Form = Literal["blend", "rhp", "rhp-literal"]
"""Use of alpha: in a blend of two strict hierarchies, or in one fractional one."""

FORMS: tuple[Form, ...] = get_args(Form)

Solver = Literal["active-set", "proxqp", "daqp"]
"""Compiled controller, or the readable reference with ProxQP or DAQP for its QPs."""

SOLVERS: tuple[Solver, ...] = get_args(Solver)

HEAVIEST = 10.0
"""Largest load that is estimated [kg]: far beyond what the arm carries (3 kg, Franka
data sheet)."""

BRAKING_RATE = 10.0
"""Speed to deceleration of the safe command [1/s]."""


class Gains(NamedTuple):
    """Feedback rates of the tasks."""

    ee_rate: float = 5.0
    """Rate from end-effector position error to speed [1/s]."""

    ee_speed: float = 0.5
    """Largest target speed of the end-effector [m/s]."""

    ee_speed_rate: float = 12.0
    """Rate from end-effector speed error to acceleration [1/s]."""

    ee_rotation_rate: float = 6.0
    """Natural frequency of the hand's orientation, critically damped [rad/s]."""

    base_rate: float = 2.0
    """Rate from the base's distance to its plan to speed [1/s]."""

    base_catch: float = 0.3
    """Largest speed added to catch up with the plan [m/s]."""

    base_speed_rate: float = 6.0
    """Rate from base speed error to acceleration [1/s]."""

    heading_rate: float = 4.0
    """Natural frequency of the heading, critically damped [rad/s]."""

    posture_rate: float = 2.5
    """Natural frequency of the arm posture, critically damped [rad/s]."""


class HierarchyConfig(NamedTuple):
    """Numbers of the recursion over levels."""

    damping: float = 1e-3
    """Weight of |x|^2 in every level, eps."""

    projector_damping: float = 1e-3
    """Damping of the projector: a row of squared norm n^2 is projected out by n^2 /
    (n^2 + damping)."""

    rho: float = 1.0
    """Weight of |x|^2 - |P x|^2 from the second level on: of the part of x that the
    projector takes away. With strict priorities, as in form "blend", it acts as far as
    the projector's damping leaves a direction open."""

    protection: float = 30.0
    """Factor of the extra weight psi (1 - psi) that a task keeps at a level below one
    with psi between 0 and 1 (fractional form; 0 for strict priorities)."""

    weighted: bool = True
    """Whether a task is weighted by the rise of its psi at a level. Without, and with
    rho 0, each level is the plain least squares of Eq. 3: form "rhp-literal"."""

    margin: float = 1e-8
    """Slack of the limits around x = 0 below the first level, in each row's unit."""

    tolerance: float = 1e-9
    """Excess over a limit up to which a closed-form level counts as inside."""

    iterations: int = 100
    """Iteration limit of a level's QP (active-set; ProxQP has its own)."""


class LimitConfig(NamedTuple):
    """Parameters of the limits on acceleration."""

    horizon: float = 4 / 240
    """Least time to reach a velocity limit [s]."""

    speed_share: float = 0.98
    """Share of the speed limits that is used; the rest is for tracking errors."""

    joint_margin: float = 0.01
    """Distance to a joint's limit at which the braking bound stops [rad]."""

    keep_out: float = 0.45
    """Least distance of the end-effector ahead of the base's origin [m]."""

    keep_out_rate: float = 8.0
    """Rate of the exponential barrier in front of the keep-out plane [1/s]."""

    keep_out_acceleration: float = 40.0
    """Largest acceleration that the barrier demands, before the box limits it [m/s^2].
    At 8 a fast hand passed the plane by 8 cm."""

    traction: float = 100.0
    """Largest force of a drive wheel on the ground along its way, and of both across it
    [N]. The wheels carry about 300 N each, but a swinging arm unloads one of them;
    where they slip, the arm does not accelerate as commanded, and its limits fail."""

    zmp: bool = False
    """Whether the zero-moment point is kept inside the support polygon; with the
    default base it is there anyway."""

    zmp_margin: float = 0.03
    """Least distance of the zero-moment point to the support polygon's edge [m]."""


@dataclass(frozen=True)
class ControllerConfig:
    """Settings of the whole-body controller."""

    form: Form = "blend"
    """"blend" mixes the two strict hierarchies; "rhp" is one fractional hierarchy, the
    paper's idea repaired; "rhp-literal" is Eq. 2 and 3 as they stand, to compare."""

    solver: Solver = "active-set"
    """"active-set" is compiled. "proxqp" is the readable reference, 40 times slower;
    "daqp" is the same with another solver (optional extra ``bench``)."""

    response: float = 2.0
    """Exponent of alpha's response: the share of stability is 1 - (1 - alpha) **
    response. At 1 it is alpha itself (Eq. 4), and half of the robot's response lies in
    alpha's last tenth."""

    gains: Gains = field(default_factory=Gains)
    """Feedback rates of the tasks."""

    hierarchy: HierarchyConfig = field(default_factory=HierarchyConfig)
    """Numbers of the recursion over levels."""

    limits: LimitConfig = field(default_factory=LimitConfig)
    """Parameters of the limits on acceleration."""

    def __post_init__(self) -> None:
        make_like_defaults(self, "controller.")
        for name, value, choices in (
            ("form", self.form, FORMS),
            ("solver", self.solver, SOLVERS),
        ):
            if value not in choices:
                raise UsageError(
                    f"controller.{name} is {value!r}, expected one of {choices}"
                )
        if not 1 <= self.response <= 10:
            raise UsageError(
                f"controller.response is {self.response}, expected 1 to 10"
            )
        check_not_negative(self.gains, *Gains._fields, of="controller.gains.")
        of, names = "controller.hierarchy.", ["damping", "projector_damping"]
        check_positive(self.hierarchy, *names, "iterations", of=of)
        names = ["rho", "protection", "margin", "tolerance"]
        check_not_negative(self.hierarchy, *names, of=of)
        of, names = "controller.limits.", ["horizon", "keep_out_rate", "traction"]
        check_positive(self.limits, *names, "speed_share", of=of)
        names = ["joint_margin", "keep_out", "keep_out_acceleration", "zmp_margin"]
        check_not_negative(self.limits, *names, of=of)
        if (share := self.limits.speed_share) > 1:
            raise UsageError(f"{of}speed_share is {share}, expected <= 1")
