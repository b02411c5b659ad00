"""Hyper-parameters of ReBRAC and MA-ReBRAC; importing them takes no torch."""

from dataclasses import dataclass

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import BOUNDED, Td3Config
from marl_mm.algorithms.registry import ALGORITHMS, Algorithm, Imported


@dataclass(frozen=True, kw_only=True)
class RebracConfig(Td3Config):
    """Hyper-parameters: the source's where it names them."""

    actor_weight: float = 0.1
    """Weight of imitation in the actors' loss, beta_1; the source chose among 0.001 to
    0.1 for locomotion (Tarasov 2023)."""

    critic_weight: float = 0.01
    """Weight of the distance from the data in the critics' targets, beta_2; the source
    chose among 0 to 0.5 for locomotion (Tarasov 2023)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, (), ("actor_weight", "critic_weight"))


_DEPARTS = (
    "The last step of an episode has its own action for the next, where the source "
    "leaves it out if the episode was cut short. Distances count only where the goal "
    f"is one that the data's action was for. {BOUNDED}"
)

ALGORITHMS.add(
    "rebrac",
    Algorithm(
        title="ReBRAC",
        loss="beta_1 |pi(s) - a|^2 - lambda min_j Q_j(s, pi(s)), "
        "lambda = 1 / mean |min_j Q_j(s, pi(s))|",
        about="ReBRAC: TD3+BC whose critics also count the distance from the data, one "
        "joint actor.",
        source="Tarasov 2023",
        learner=Imported("marl_mm.algorithms.rebrac:Rebrac"),
        presets=presets_of("rebrac", RebracConfig()),
        advice="Where rewards tell more than the data's actions. Both weights must "
        "suit the data; where that cannot be tried out, cloning is safer.",
        departs=_DEPARTS,
    ),
)
ALGORITHMS.add(
    "ma-rebrac",
    Algorithm(
        title="MA-ReBRAC",
        loss="beta_1 |pi_i(o_i) - a_i|^2 - lambda_i min_j Q_j(s, (pi_i(o_i), pi_-i)), "
        "lambda_i = 1 / mean |min_j Q_j|, for each agent i",
        about="MA-ReBRAC: ReBRAC's critics of the whole team, and an actor for each "
        "agent.",
        source="Tarasov 2023",
        learner=Imported("marl_mm.algorithms.rebrac:MaRebrac"),
        presets=presets_of("ma-rebrac", RebracConfig()),
        advice="As ReBRAC, for agents that see their own part. Where the data hold "
        "several conventions of equal worth, agents end between them.",
        departs=f"The source knows no agents. {_DEPARTS}",
    ),
)
