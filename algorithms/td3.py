"""TD3's update (Fujimoto 2018), which offline algorithms add terms to.

Loss of the twin critics: (Q_j(s, a) - r - gamma (1 - terminated) min_j Q_j'(s', a'))^2,
where a' is the target actors' action with clipped noise. Every ``policy_delay`` updates
the actors improve, and the targets follow.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import torch

from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.offline_critics import CriticLearner
from marl_mm.algorithms.replay import Judge
from marl_mm.datasets.arrays import EpisodeArrays


class Td3Learner(CriticLearner):
    """Twin critics, and actors that follow them later; see ``CriticLearner``."""

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
            value = self._next_value(next_state, next_action, batch)
            target = self._target(batch, value)
        losses = self._learn_critics(state, batch, target)

        if self.step % config.policy_delay == 0:
            losses |= self._improve(state, batch)
            self._target_actors.follow(self.actors, config.target_rate)
            self._target_critics.follow(self.critics, config.target_rate)
        return {f"loss/{name}": loss.detach() for name, loss in losses.items()}

    def _next_value(
        self, state: torch.Tensor, action: torch.Tensor, batch: OfflineBatch
    ) -> torch.Tensor:
        """Value of the next state, by its action, shape (S, pairs, B)."""
        return self._target_critics.least(state, action)

    @abstractmethod
    def _improve(
        self, state: torch.Tensor, batch: OfflineBatch
    ) -> dict[str, torch.Tensor]:
        """One gradient step of every actor; losses of each seed, shape (S,)."""

    def __init__(
        self,
        config: Any,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
        *,
        rates: tuple[float, float] | None = None,
        extra: int = 0,
    ) -> None:
        more: dict[str, Any] = {"rates": rates, "extra": extra}
        super().__init__(config, arrays, judge, seeds, device, **more)
        self._target_actors = self.actors.copy()
        self._parts |= {"target_actors": self._target_actors}
