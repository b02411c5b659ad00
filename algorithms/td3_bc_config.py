"""Hyper-parameters of TD3+BC, by preset; importing them takes no torch."""

import math
from dataclasses import dataclass
from typing import Any, Literal

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.config_checks import Precision, check_ranges
from marl_mm.algorithms.registry import ALGORITHMS, PAPER, Algorithm, Imported
from marl_mm.errors import UsageError

WEIGHTED = ("delta_x", "delta_y", "delta_z", "alpha")
"""Entries of the action whose imitation can be weighted."""


@dataclass(frozen=True)
class Td3BcConfig:
    """Hyper-parameters: the paper's, and those of ``td3_bc_additions``."""

    updates: int = 10_000
    """Gradient steps of the critics; the paper has 100,000 (Table 3) and 180,000
    (Table 4)."""

    batch_size: int = 256
    """Transitions per update (Table 3)."""

    actor_learning_rate: float = 5e-4
    """Learning rate of the actor's Adam (Table 3)."""

    critic_learning_rate: float = 5e-4
    """Learning rate of the critics' Adam (Table 3)."""

    discount: float = 0.95
    """Discount per step, gamma (Table 3)."""

    target_rate: float = 0.005
    """Share of the networks that goes into their targets at each update of the actor,
    tau (Table 3)."""

    q_weight: float = 0.5
    """Weight of the value against imitation, c; 2.5 in Fujimoto & Gu 2021."""

    q_weight_end: float | None = None
    """Weight c at the last update, reached in a straight line; by default c stays."""

    policy_delay: int = 2
    """Updates of the critics per update of actor and targets (Fujimoto 2018)."""

    target_noise: float = 0.2
    """Standard deviation of the noise on the target's action, in halves of its
    range."""

    target_noise_clip: float = 0.5
    """Bound of the noise on the target's action, in halves of its range."""

    future: float = 0.2
    """Share of transitions relabelled with a goal that their episode reached later."""

    elsewhere: float = 0.4
    """Share of transitions relabelled with the goal of any other step. They are not
    imitated."""

    clip_targets: bool = True
    """Whether the critics' targets are clipped at the task's highest return, where it
    has one: of one goal the reward of a perfect hit."""

    layer_norm: bool = True
    """Whether the critics' hidden layers are normalised (Ball 2023)."""

    imitate: Literal["all", "better", "successful"] = "successful"
    """Imitated actions: all, those that the critic values higher than the actor's (Nair
    2018), or those of episodes that reached their goal."""

    imitation_weights: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    """Weights of delta_x, delta_y, delta_z and alpha in the imitation error, relative
    to each other and to other entries', which weigh 1: their mean is made 1."""

    imitation_scaled: bool = True
    """Whether the imitation error of each entry is divided by its spread in the data:
    where the data hardly vary, the critic knows no better."""

    hidden: tuple[int, ...] = (128, 128)
    """Units of the hidden layers of actor and critics; the paper is silent."""

    std_floor: float = 0.01
    """Least standard deviation an observation is scaled by."""

    precision: Precision = "auto"
    """Precision of products of float32 matrices, as torch has it. medium is faster on
    many CPUs and GPUs, and rounds to bfloat16 where these have units for it. auto takes
    medium where a trial at the start shows it to be as exact."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            positive=(
                "batch_size",
                "actor_learning_rate",
                "critic_learning_rate",
                "target_rate",
                "policy_delay",
                "std_floor",
            ),
            not_negative=(
                *("updates", "q_weight", "target_noise", "target_noise_clip"),
            ),
            shares=("discount", "target_rate", "future", "elsewhere"),
        )
        if self.q_weight_end is not None:
            check_ranges(self, (), not_negative=("q_weight_end",))
        weights = self.imitation_weights
        if len(weights) != len(WEIGHTED) or not all(0 < w < math.inf for w in weights):
            raise UsageError(
                f"imitation_weights is {weights}, expected one > 0 for each of "
                f"{', '.join(WEIGHTED)}"
            )
        if self.future + self.elsewhere > 1:
            raise UsageError(
                f"future is {self.future} and elsewhere {self.elsewhere}, expected at "
                "most 1 together"
            )


TABLE_3: dict[str, Any] = {
    "updates": 100_000,  # Table 3; 180,000 in Table 4
    "batch_size": 256,  # Table 3
    "actor_learning_rate": 5e-4,  # Table 3
    "critic_learning_rate": 5e-4,  # Table 3
    "discount": 0.95,  # Table 3
    "target_rate": 0.005,  # Table 3
    "q_weight": 2.5,  # Fujimoto & Gu 2021
    "q_weight_end": None,
    "policy_delay": 2,  # Fujimoto 2018
    "target_noise": 0.1,  # Table 3: "Standard deviation", of what it does not say
    "target_noise_clip": 0.5,  # Fujimoto 2018
    "future": 0.0,
    "elsewhere": 0.0,
    "imitate": "all",
    "imitation_weights": (1.0, 1.0, 1.0, 1.0),
    "imitation_scaled": False,
    "clip_targets": False,
    "layer_norm": False,
}
"""Hyper-parameters of Table 3, and of the cited source where it is silent. Hidden
layers and the floor of deviations are ours."""

ALGORITHMS.add(
    "td3-bc",
    Algorithm(
        title="TD3+BC",
        loss="-lambda Q_1(s, pi(s)) + MSE(a, pi(s)), lambda = c / mean |Q_1(s, pi(s))|",
        about="TD3+BC: one agent that sees and sets everything (paper, Algorithm 2).",
        source="Fujimoto & Gu 2021",
        advice="Where random steps are among good ones, or the last centimetres "
        "decide, and one actor may see everything. Not for long tasks with a grasp, "
        "where cloning does far better, and not with the paper's numbers on good data "
        "alone: its critic has never seen a bad action, and runs away.",
        departs="Ours shows the critics goals that an action was not meant for, "
        "imitates successes only, measures errors by how much the data vary, and "
        "bounds what critics may say: with the paper's settings they run away on good "
        "data. Exchanged goals are scaled as the data's own, and lie far outside of "
        "them where those hardly vary.",
        learner=Imported("marl_mm.algorithms.td3_bc:Td3Bc"),
        presets=presets_of("td3-bc", Td3BcConfig()) | {PAPER: Td3BcConfig(**TABLE_3)},
    ),
)
