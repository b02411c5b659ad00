"""Hyper-parameters of MATD3+BC, by preset; importing them takes no torch."""

from dataclasses import dataclass
from typing import Literal

from marl_mm.algorithms.chosen import presets_of
from marl_mm.algorithms.registry import ALGORITHMS, PAPER, Algorithm, Imported
from marl_mm.algorithms.td3_bc_config import TABLE_3, Td3BcConfig


@dataclass(frozen=True)
class Matd3BcConfig(Td3BcConfig):
    """Hyper-parameters: those of TD3+BC, and what the agents share."""

    critics: Literal["shared", "own"] = "shared"
    """Whether each agent has a pair of critics of its own, as in the source: they learn
    from the same reward. Ours see the joint state and action."""

    others: Literal["data", "policy"] = "policy"
    """Other agents' action in an actor's loss: the dataset's (as in Lowe 2017), or the
    one that their policy takes now."""


ALGORITHMS.add(
    "matd3-bc",
    Algorithm(
        title="MATD3+BC",
        loss="-lambda_i Q_i(s, (pi_i(o_i), a_-i)) + MSE(a_i, pi_i(o_i))",
        about="MATD3+BC: decentralised actors, centralised critics (Pan 2022).",
        source="Pan 2022",
        advice="Where TD3+BC is right and agents act on their own observations. Not "
        "for long tasks with a grasp, where MABC does far better; where the data show "
        "several conventions, it imitates their mean.",
        departs="As TD3+BC; and as the agents share one reward, they share one pair "
        "of critics, of the joint state and action: in the source's code each agent's "
        "are of its own observation and action.",
        learner=Imported("marl_mm.algorithms.matd3_bc:Matd3Bc"),
        presets=presets_of("matd3-bc", Matd3BcConfig())
        | {PAPER: Matd3BcConfig(**TABLE_3, critics="own", others="data")},
    ),
)
