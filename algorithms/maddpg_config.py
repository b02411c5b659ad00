"""Hyper-parameters of MADDPG, by preset; importing them takes no torch."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from marl_mm.algorithms.ddpg_config import TABLE_2, DdpgConfig, check_hindsight
from marl_mm.algorithms.registry import ALGORITHMS, PAPER, TUNED, Algorithm, Imported


@dataclass(frozen=True)
class MaddpgConfig(DdpgConfig):
    """Hyper-parameters: those of DDPG, and the other agents' actions."""

    others: Literal["replay", "policy"] = "policy"
    """Other agents' action in an actor's loss: the one in the replay (Lowe 2017), or
    the one that their policy takes now."""


_PAPER = MaddpgConfig(**TABLE_2, others="replay")  # Lowe 2017

ALGORITHMS.add(
    "maddpg",
    Algorithm(
        title="MADDPG",
        loss="-Q(s, (pi_i(o_i), a_-i)) + penalty mean pi_i(o_i)^2",
        about="MADDPG: decentralised actors, one centralised critic (Lowe 2017).",
        source="Lowe 2017",
        advice="To see what hindsight is worth to a team; else take MADDPG + HER.",
        departs="The agents share one reward, hence one critic, of which the source "
        "has one for each agent. Otherwise as DDPG.",
        learner=Imported("marl_mm.algorithms.maddpg:Maddpg"),
        presets={
            TUNED: MaddpgConfig(hindsight=0),
            PAPER: replace(_PAPER, hindsight=0),
        },
        online=True,
        check=partial(check_hindsight, "maddpg"),
    ),
)
ALGORITHMS.add(
    "maddpg-her",
    Algorithm(
        title="MADDPG + HER",
        loss="-Q(s, (pi_i(o_i), a_-i)) + penalty mean pi_i(o_i)^2, on relabelled goals",
        about="MADDPG that replays most steps with goals reached later (HER).",
        source="Lowe 2017; Andrychowicz 2017",
        advice="Without data, where agents act on their own observations: on "
        "`Reach-v0` it needs hardly more episodes than DDPG + HER, and on "
        "`SmoothReach-v0` its alpha is worth as much. On grasping it was not tried.",
        departs="The agents share one reward, hence one critic, of which the source "
        "has one for each agent. Otherwise as DDPG + HER.",
        learner=Imported("marl_mm.algorithms.maddpg:Maddpg"),
        presets={TUNED: MaddpgConfig(), PAPER: _PAPER},
        online=True,
        check=partial(check_hindsight, "maddpg-her"),
    ),
)
