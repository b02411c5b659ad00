"""MADDPG, with and without hindsight (Lowe 2017): DDPG with an actor per agent.

Actors see their own observations only; the critic, in training only, sees the joint
state and action. The agents share their reward, so one critic and one batch serve all:
actor loss of agent i: -Q(s, (pi_i(o_i), a_-i)), where a_-i is what the others would do
now or, as in the source, what they did.
"""

from typing import ClassVar

import torch

from marl_mm.algorithms.ddpg import Ddpg
from marl_mm.algorithms.maddpg_config import MaddpgConfig
from marl_mm.algorithms.replay import Batch
from marl_mm.layout import AgentLayout


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
        output: torch.Tensor = agent.actor(agent.observed(batch.observation))
        action = batch.action.clone()
        action[:, list(agent.layout.action)] = output
        value = self.critic(batch.observation, action)
        loss: torch.Tensor = -value.mean()
        # Shares add up to 1: all together weigh as much as one of the joint action.
        share = output.shape[-1] / len(self.layout.action)
        return loss + self.config.action_penalty * share * output.square().mean()
