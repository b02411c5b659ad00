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

from collections.abc import Sequence
from typing import ClassVar

import torch

from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.offline_critics import CriticLearner
from marl_mm.algorithms.rebrac_config import RebracConfig
from marl_mm.algorithms.replay import Judge
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import columns


class Rebrac(CriticLearner):
    """Actors and twin critics, with targets; see ``CriticLearner``."""

    name: ClassVar[str] = "rebrac"
    config: RebracConfig

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; losses of each seed, shape (S,)."""
        config, batch = self.config, self._batches.next()
        self.step += 1
        state = self.normalizer(batch.observation)
        next_state = self.normalizer(batch.next_observation)

        with torch.no_grad():
            noise = batch.noise * config.target_noise
            noise.clamp_(-config.target_noise_clip, config.target_noise_clip)
            next_action = (self._target_actors.joint(next_state) + noise).clamp_(-1, 1)
            distance = (next_action - batch.next_action).square().sum(dim=2)
            value = self._target_critics.least(next_state, next_action)[:, 0]
            value -= config.critic_weight * distance * batch.imitated
            target = self._target(batch, value)

        errors = self.critics.values(state, batch.action) - target[:, None, None]
        loss = errors.square().mean(dim=3).sum(dim=(1, 2))
        self.critics.descend(loss)
        losses = {"loss/critic": loss.detach()}

        if self.step % config.policy_delay == 0:
            losses |= self._improve(state, batch)
            self._target_actors.follow(self.actors, config.target_rate)
            self._target_critics.follow(self.critics, config.target_rate)
        return losses

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
            losses[f"loss/{agent.name}"] = loss.detach()
            losses[f"loss/imitation/{agent.name}"] = imitation.detach()
        return losses

    def __init__(
        self,
        config: RebracConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        super().__init__(config, arrays, judge, seeds, device)
        self._target_actors = self.actors.copy()
        self._parts |= {"target_actors": self._target_actors}


class MaRebrac(Rebrac):
    """The same with an actor for each agent."""

    name: ClassVar[str] = "ma-rebrac"
    team = True
