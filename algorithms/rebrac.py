"""ReBRAC (Tarasov 2023): TD3+BC that keeps actor and critics near the data, apart.

Loss of the twin critics: (Q_j(s, a) - r - gamma (1 - terminated) (min_j Q_j'(s', a')
- beta_2 |a' - a'_data|^2))^2, where a' is the target actors' action with clipped noise
and a'_data the data's next one. Every second update each actor follows:
beta_1 |pi_i(o_i) - a_i|^2 - lambda_i min_j Q_j(s, (pi_i(o_i), a_-i)), where
lambda_i = 1 / mean |min_j Q_j| and a_-i is what the others would do now. A team shares
the critics, which are of the joint state and action; each agent has its own actor.

Squares are summed over entries, and actors follow the lower critic, as in the source's
code. The last step of an episode has no next action. The source leaves the step out
where the episode was cut short; here its own action stands for the next. Neither
distance counts where the goal is one that the data's action was not for.
"""

from typing import ClassVar

import torch

from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.rebrac_config import RebracConfig
from marl_mm.algorithms.td3 import Td3Learner
from marl_mm.layout import columns


class Rebrac(Td3Learner):
    """Actors and twin critics, with targets; see ``Td3Learner``."""

    name: ClassVar[str] = "rebrac"
    config: RebracConfig

    def _next_value(
        self, state: torch.Tensor, action: torch.Tensor, batch: OfflineBatch
    ) -> torch.Tensor:
        """Value of the next state less the distance of its action from the data's."""
        distance = (action - batch.next_action).square().sum(dim=2)
        distance = self.config.critic_weight * distance * batch.imitated
        return super()._next_value(state, action, batch) - distance[:, None]

    def _improve(
        self, state: torch.Tensor, batch: OfflineBatch
    ) -> dict[str, torch.Tensor]:
        """One gradient step of every actor."""
        losses = {}
        with torch.no_grad():
            now = self.actors.joint(state)
        for agent in self.layouts:
            entries, action = columns(agent.action), now.clone()
            action[..., entries] = self.actors.action(agent.name, state)
            value = self.critics.least(state, action)[:, 0]
            weight = 1 / value.detach().abs().mean(dim=1)
            distance = (action - batch.action)[..., entries].square().sum(dim=2)
            imitation = (distance * batch.imitated).mean(dim=1)
            loss = self.config.actor_weight * imitation - weight * value.mean(dim=1)
            self.actors.descend(agent.name, loss)
            losses[agent.name] = loss
            losses[f"imitation/{agent.name}"] = imitation
        return losses


class MaRebrac(Rebrac):
    """The same with an actor for each agent."""

    name: ClassVar[str] = "ma-rebrac"
    team = True
