"""TD3+BC (paper, Algorithm 2; Fujimoto & Gu 2021): one actor that sees and sets all.

Loss of the twin critics: (Q_j(s, a) - r - gamma (1 - terminated) min_j Q_j'(s', a'))^2,
where a' is the target actor's action with clipped noise. Every ``policy_delay`` updates
the actor follows: -lambda Q_1(s, pi(s)) + MSE(a, pi(s)), where lambda =
c / mean |Q_1(s, pi(s))|. Our additions to that stand in ``td3_bc_additions``.
"""

from collections.abc import Sequence
from typing import ClassVar

import torch

from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.td3 import Td3Learner
from marl_mm.algorithms.td3_bc_additions import Imitation, q_weight
from marl_mm.algorithms.td3_bc_config import Td3BcConfig
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import JOINT_NAME


class Td3Bc(Td3Learner):
    """One actor and twin critics, with targets; see ``Td3Learner``."""

    name: ClassVar[str] = "td3-bc"
    config: Td3BcConfig

    # --- Update --------------------------------------------------------------

    def _improve(
        self, state: torch.Tensor, batch: OfflineBatch
    ) -> dict[str, torch.Tensor]:
        """One gradient step of the actor."""
        action = self.actors.joint(state)
        value = self.critics.first(state, action)
        error = self._imitation.error(action, state, batch, value)
        loss = error - self._lambda(value) * value.mean(dim=1)
        self.actors.descend(JOINT_NAME, loss)
        return {"actor": loss, "imitation": error}

    def _lambda(self, value: torch.Tensor) -> torch.Tensor:
        """Weight of the value against imitation, shape (S,)."""
        return q_weight(self.config, self.step) / value.detach().abs().mean(dim=1)

    # --- Parts ---------------------------------------------------------------

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
        self._imitation = Imitation(config, arrays, self.critics, device)
