"""TD3+BC (paper, Algorithm 2; Fujimoto & Gu 2021): one actor that sees and sets all.

Loss of the twin critics: (Q_j(s, a) - r - gamma (1 - terminated) min_j Q_j'(s', a'))^2,
where a' is the target actor's action with clipped noise. Every second update the actor
follows: -lambda Q_1(s, pi(s)) + MSE(a, pi(s)), where lambda = c / mean |Q_1(s, pi(s))|.
Our additions to that stand in ``td3_bc_additions``.
"""

from collections.abc import Sequence
from typing import ClassVar

import torch

from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.offline_critics import CriticLearner
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.td3_bc_additions import Imitation, q_weight
from marl_mm.algorithms.td3_bc_config import Td3BcConfig
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import JOINT_NAME


class Td3Bc(CriticLearner):
    """One actor and twin critics, with targets; see ``CriticLearner``."""

    name: ClassVar[str] = "td3-bc"
    config: Td3BcConfig

    # --- Update --------------------------------------------------------------

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
            value = self._target_critics.least(next_state, next_action)
            target = self._target(batch, value)  # clipped, if asked: that is ours

        errors = self.critics.values(state, batch.action) - target[:, :, None]
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
        """One gradient step of the actor."""
        action = self.actors.joint(state)
        value = self.critics.first(state, action)
        error = self._imitation.error(action, state, batch, value)
        loss = error - self._lambda(value) * value.mean(dim=1)
        self.actors.descend(JOINT_NAME, loss)
        return {"loss/actor": loss.detach(), "loss/imitation": error.detach()}

    def _lambda(self, value: torch.Tensor) -> torch.Tensor:
        """Weight of the value against imitation, shape (S,)."""
        return q_weight(self.config, self.step) / value.detach().abs().mean(dim=1)

    # --- Networks ------------------------------------------------------------

    def __init__(
        self,
        config: Td3BcConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        rates = config.actor_learning_rate, config.critic_learning_rate
        super().__init__(config, arrays, judge, seeds, device, rates=rates)
        self._target_actors = self.actors.copy()
        self._parts |= {"target_actors": self._target_actors}
        self._imitation = Imitation(config, arrays, self.critics, device)
