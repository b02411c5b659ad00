"""Hyper-parameters that offline algorithms share; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.config_checks import Precision, check_ranges
from marl_mm.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class CloningConfig:
    """Hyper-parameters of algorithms that imitate."""

    updates: int = 10_000
    """Number of gradient steps."""

    batch_size: int = 256
    """Number of transitions per update; the paper's (Table 3)."""

    learning_rate: float = 5e-4
    """Learning rate of Adam, of all networks; the paper's (Table 3)."""

    future: float = 0.0
    """Share of transitions relabelled with a goal that their episode reached later."""

    hidden: tuple[int, ...] = (128, 128)
    """Numbers of units of the hidden layers of all networks."""

    std_floor: float = 0.01
    """Least standard deviation that observations are scaled by."""

    precision: Precision = "auto"
    """Precision of products of float32 matrices, as torch has it. medium is faster on
    many CPUs and GPUs, and rounds to bfloat16 where these have units for it. auto takes
    medium where a trial at the start shows it to be as exact."""

    def __post_init__(self) -> None:
        positive = ("batch_size", "learning_rate", "std_floor")
        check_ranges(self, positive, ("updates",), shares=("future",))


BOUNDED = (
    "Targets are clipped at the task's highest return, and critics' hidden layers are "
    "normalised, whatever the source does."
)
"""What all algorithms with critics have of ours."""


@dataclass(frozen=True, kw_only=True)
class CriticConfig(CloningConfig):
    """Hyper-parameters of algorithms that have critics."""

    discount: float = 0.95
    """Discount of rewards per step, gamma."""

    target_rate: float = 0.005
    """Share of the networks that goes into their targets, tau: at each update, or at
    each of the actors where these have a policy_delay."""

    elsewhere: float = 0.0
    """Share of transitions relabelled with the goal of any other step. They are not
    imitated."""

    clip_targets: bool = True
    """Whether the critics' targets are clipped at the task's highest return, where it
    has one: of one goal the reward of a perfect hit."""

    layer_norm: bool = True
    """Whether the critics' hidden layers are normalised (Ball 2023)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, ("target_rate",), shares=("discount", "target_rate"))
        check_ranges(self, (), shares=("elsewhere",))
        if self.future + self.elsewhere > 1:
            raise UsageError(
                f"future is {self.future} and elsewhere {self.elsewhere}, expected at "
                "most 1 together"
            )


@dataclass(frozen=True, kw_only=True)
class Td3Config(CriticConfig):
    """Hyper-parameters of algorithms that learn as TD3 does."""

    policy_delay: int = 2
    """Updates of the critics per update of actors and targets (Fujimoto 2018)."""

    target_noise: float = 0.2
    """Standard deviation of the noise on the target's action, in halves of its
    range."""

    target_noise_clip: float = 0.5
    """Bound of the noise on the target's action, in halves of its range."""

    def __post_init__(self) -> None:
        super().__post_init__()
        noise = "target_noise", "target_noise_clip"
        check_ranges(self, ("policy_delay",), noise)
