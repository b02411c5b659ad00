"""OMAR, offline multi-agent RL with actor rectification (Pan 2022).

Loss of the twin critics: (Q_j(s, a) - r - gamma (1 - terminated) min_j Q_j'(s', a'))^2
+ alpha (mean_i log E[exp Q_j(s, (u_i, a_-i)) / q(u_i)] - Q_j(s, a)), as in ``cfcql``
with equal shares. Loss of each actor, every second update: -(1 - c) Q_1(s, (pi_i(o_i),
a_-i)) + c |pi_i(o_i) - best_i|^2, and CFCQL's terms of c and b, here `action_penalty`
and `bound_penalty`. The action best_i is the best of a few rounds of samples: the first
from a wide Gaussian, each other one from the mean and deviation of the best so far, the
actor's own action among them. So an actor leaves a hill of Q that is not the highest,
which conservative critics have at each way that the data show.

What departs: in the source each agent has critics of its own observation and action.
Our agents share one reward, which the others' actions set as much: to critics that do
not see these it is noise. One pair here sees the joint state and action, conservative
in one agent at a time; a_-i is what the others would do now. The source's code weighs
samples by exp Q, or for robots takes the best few: these, whatever the reward's unit.
"""

from typing import ClassVar

import torch

from marl_mm.algorithms.cfcql import Cfcql
from marl_mm.algorithms.cfcql_config import CfcqlConfig
from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.omar_config import OmarConfig
from marl_mm.layout import AgentLayout, columns


class Omar(Cfcql):
    """CFCQL's critics, and actors that search; see ``Cfcql``."""

    name: ClassVar[str] = "omar"
    config: OmarConfig

    # --- Update --------------------------------------------------------------

    def _actor_loss(
        self,
        agent: AgentLayout,
        state: torch.Tensor,
        batch: OfflineBatch,
        others: torch.Tensor,
        output: torch.Tensor,
    ) -> torch.Tensor:
        """Loss of an agent's actions, shape (S,); see ``Cfcql``."""
        searched = slice(self.config.searched)
        action = others.clone()
        action[..., columns(agent.action)] = output
        value = self.critics.first(state, action)
        of_critics = super()._noise(self.config) * others.shape[-1]
        best = self._best(
            agent,
            state[:, searched],
            action[:, searched].detach(),
            value[:, searched].detach(),
            batch.extra[:, searched, of_critics:],
        )
        error = (output[:, searched] - best).square().mean(dim=(1, 2))
        mix = self.config.mix
        return mix * error - (1 - mix) * value.mean(dim=1)

    @torch.no_grad()
    def _best(
        self,
        agent: AgentLayout,
        state: torch.Tensor,
        action: torch.Tensor,
        value: torch.Tensor,
        noise: torch.Tensor,
    ) -> torch.Tensor:
        """An agent's best actions that a search finds, shape (S, b, k_i).

        Args:
            agent: The agent.
            state: Normalised joint states, shape (S, b, d).
            action: Joint actions by the actors, shape (S, b, k).
            value: Values of these, shape (S, b).
            noise: Standard normal noise, shape (S, b, rounds candidates k).
        """
        config, own = self.config, columns(agent.action)
        shape = config.rounds, config.candidates, action.shape[-1]
        noise = noise.reshape(*action.shape[:2], *shape)[..., own].movedim(1, 3)
        found, values = action[:, None, :, own], value[:, None]
        mean = torch.zeros_like(found)
        spread = torch.full_like(found, config.search_spread)
        states = state[:, None].expand(-1, config.candidates, -1, -1).flatten(1, 2)
        for number in range(config.rounds):
            candidates = (mean + spread * noise[:, number]).clamp_(-1, 1)
            joint = action[:, None].repeat(1, config.candidates, 1, 1)
            joint[..., own] = candidates
            worths = self.critics.first(states, joint.flatten(1, 2)).view(
                candidates.shape[:3]
            )
            found = torch.cat([found, candidates], dim=1)
            values = torch.cat([values, worths], dim=1)
            values, rank = values.topk(config.elites, dim=1)
            found = found.take_along_dim(rank[..., None], dim=1)
            mean = found.mean(dim=1, keepdim=True)
            spread = found.std(dim=1, keepdim=True, correction=0)
        return found[:, 0]

    # --- Networks ------------------------------------------------------------

    @staticmethod
    def _noise(config: CfcqlConfig) -> int:
        """Number of normal draws for each entry of the action."""
        assert isinstance(config, OmarConfig)
        return Cfcql._noise(config) + config.rounds * config.candidates
