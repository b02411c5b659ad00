"""Hyper-parameters of CFCQL and CQL; importing them takes no torch."""

from dataclasses import dataclass, field
from typing import Literal

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import BOUNDED, Td3Config
from marl_mm.algorithms.registry import ALGORITHMS, Algorithm, Imported
from marl_mm.declared import ADDED


@dataclass(frozen=True, kw_only=True)
class CfcqlConfig(Td3Config):
    """Hyper-parameters: the source's code's where it names them."""

    conservatism: float = 5.0
    """Weight of the conservative term, alpha, for values of about 10; by dataset 0.1 to
    5 in CFCQL's code and 0.5 to 5 in OMAR's. Where it outweighs the rewards, each way
    of the data is a peak that actors do not leave."""

    penalized: int = 64
    """Number of a batch's transitions that the conservative term is of, at most the
    batch; all of it in the source. It takes most of an update's time."""

    samples: int = 5
    """Actions of each kind, uniform and near the policy's, that the conservative term
    draws for each transition and agent; 10 of each of three kinds in CFCQL's and OMAR's
    code for robots, 10 uniform ones in that for particles."""

    sample_noise: float = 0.2
    """Standard deviation of actions drawn near the policy's, in halves of their
    range."""

    focus: float = 1.0
    """Weight of an agent's distance from the data in its share of the conservative
    term, tau; 0: all shares are the same. A single agent has all of it."""

    others: Literal["data", "policy"] = "policy"
    """Other agents' action in an actor's loss: the dataset's, as in CFCQL's code, or
    the one that their policy takes now. A single agent has no others."""

    action_penalty: float = 1e-3
    """Weight of the mean square of the action in the actors' loss."""

    bound_penalty: float = field(default=0.0, metadata=ADDED)
    """Weight of -log(1 - a^2), summed over an agent's entries, in the actors' loss; as
    SAC's entropy does, it keeps actions off their bounds, from where tanh passes no
    gradient back. In units of value."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(
            self,
            positive=("penalized", "samples", "sample_noise"),
            not_negative=("conservatism", "focus", "action_penalty", "bound_penalty"),
        )


ALGORITHMS.add(
    "cql",
    Algorithm(
        title="CQL",
        loss="-Q_1(s, pi(s)), with Q low outside of the data",
        about="CQL: conservative critics, and one actor that sees and sets everything.",
        source="Kumar 2020",
        advice="Made for data of mixed quality without gaps. The preset was tuned on "
        "Reach-v0 and does not transfer: tune `conservatism` first. Where the data "
        "show one way only, cloning is as good and quicker.",
        departs="The actor is TD3's instead of SAC's. The conservative term is of a "
        "part of the batch, without samples near the policy at the next state. "
        f"{BOUNDED}",
        learner=Imported("marl_mm.algorithms.cfcql:Cql"),
        presets=presets_of("cql", CfcqlConfig()),
    ),
)
ALGORITHMS.add(
    "cfcql",
    Algorithm(
        title="CFCQL",
        loss="-Q_1(s, (pi_i(o_i), a_-i)), with Q low where one agent leaves the data",
        about="CFCQL: critics that are conservative in one agent at a time.",
        source="Shao 2023",
        advice="Made for data of mixed quality and several agents, above all many. The "
        "preset does not transfer: tune `conservatism` first. It does not say which of "
        "several conventions to keep if all are worth the same.",
        departs="The distance from the data is a square error, in the source a "
        "variational auto-encoder's likelihood. The agents that left the data farthest "
        "are held down most, as in the source's code; its first version for continuous "
        "actions held them down least. In the loss of an actor the others act by their "
        "policies, see `others`. The source clips the gradients of critics and actors, "
        "and makes five updates of critics to one of actors, here it is two. "
        f"{BOUNDED}",
        learner=Imported("marl_mm.algorithms.cfcql:Cfcql"),
        presets=presets_of("cfcql", CfcqlConfig()),
    ),
)
