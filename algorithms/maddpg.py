"""MADDPG, with and without hindsight (Lowe 2017): DDPG with an actor per agent.

Actors see their own observations only; the critic, in training only, sees the joint
state and action. The agents share their reward, so one critic and one batch serve both:
actor loss of agent i: -Q(s, (pi_i(o_i), a_-i)), where a_-i is what the others would do
now or, as in the source, what they did.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Literal

import torch

from marl_mm.algorithms.ddpg import TABLE_2, Ddpg, DdpgConfig, check_hindsight
from marl_mm.algorithms.registry import ALGORITHMS, PAPER, TUNED, Algorithm
from marl_mm.algorithms.replay import Batch
from marl_mm.layout import AgentLayout

# --- Config ------------------------------------------------------------------


@dataclass(frozen=True)
class MaddpgConfig(DdpgConfig):
    """Hyper-parameters: those of DDPG, and what the agents take each other to do."""

    others: Literal["replay", "policy"] = "policy"
    """What the other agent's action is in an actor's loss: the one in the replay (Lowe
    2017) or the one it would take now."""


class Maddpg(Ddpg):
    """Learns decentralised actors with a centralised critic; see ``Ddpg``."""

    base_name: ClassVar[str] = "maddpg"
    config: MaddpgConfig

    def _layouts(self) -> tuple[AgentLayout, ...]:
        """One actor for each agent."""
        return self.layout.agents

    # --- Update --------------------------------------------------------------

    def _actor_loss(self, batch: Batch) -> torch.Tensor:
        if self.config.others == "policy":
            return super()._actor_loss(batch)
        losses = [self._agent_loss(name, batch) for name in self.agents]
        return sum(losses, torch.zeros(()))

    def _agent_loss(self, name: str, batch: Batch) -> torch.Tensor:
        """Loss of one agent while the others act as they did."""
        agent = self.agents[name]
        own: torch.Tensor = agent.actor(agent.own(batch.observation))
        action = batch.action.clone()
        action[:, list(agent.layout.action)] = own
        value = self.critic(batch.observation, action)
        loss: torch.Tensor = -value.mean()
        # Together as much as of all at once.
        share = own.shape[-1] / len(self.layout.action)
        return loss + self.config.action_penalty * share * own.square().mean()


_PAPER = MaddpgConfig(**TABLE_2, others="replay")  # Lowe 2017

ALGORITHMS.add(
    "maddpg",
    Algorithm(
        about="MADDPG: decentralised actors, one centralised critic (Lowe 2017).",
        source="Lowe 2017",
        learner=Maddpg,
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
        about="MADDPG that replays most steps with goals reached later (HER).",
        source="Lowe 2017; Andrychowicz 2017",
        learner=Maddpg,
        presets={TUNED: MaddpgConfig(), PAPER: _PAPER},
        online=True,
        check=partial(check_hindsight, "maddpg-her"),
    ),
)
