"""Values in-sample (Kostrikov 2022), which never ask critics for unseen actions.

Loss of V: L_tau(min_j Q_j'(s, a) - V(s)), where L_tau(x) = |tau - 1(x < 0)| x^2; of the
twin critics: (Q_j(s, a) - r - gamma (1 - terminated) V(s'))^2.
"""

from collections.abc import Sequence
from typing import Any

import torch

from marl_mm.algorithms.networks import PLAIN, Form
from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.offline_critics import CriticLearner
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.seeded import SeededCritics
from marl_mm.datasets.arrays import EpisodeArrays


class InSampleLearner(CriticLearner):
    """Learns values and twin critics of joint actions beside its actors.

    Args:
        config: Hyper-parameters of a ``CriticConfig``, and ``expectile``.
        arrays: The dataset's episodes.
        judge: The task's reward and termination.
        seeds: Seeds of initial weights and batches, S of them.
        device: "cpu" or "cuda".
        form: Form of the actors' networks.
        extra: Entries of noise that batches have beside the usual.
    """

    def __init__(
        self,
        config: Any,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
        *,
        form: Form = PLAIN,
        extra: int = 0,
    ) -> None:
        super().__init__(config, arrays, judge, seeds, device, form=form, extra=extra)
        self.values = SeededCritics(
            len(self.layout.state),
            1,
            config.hidden,
            config.layer_norm,
            config.learning_rate,
            seeds,
            device,
            twins=1,
        )
        self._parts |= {"values": self.values}

    def _learn_values(
        self, state: torch.Tensor, batch: OfflineBatch
    ) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """One gradient step of values and critics.

        Returns:
            Advantages of the data's actions, shape (S, B); losses, each of shape (S,).
        """
        config, action = self.config, batch.action
        next_state, no_action = self.normalizer(batch.next_observation), action[..., :0]

        with torch.no_grad():
            taken = self._target_critics.least(state, action)[:, 0]
        advantage = taken - self.values.first(state, no_action)
        weight = (config.expectile - (advantage < 0).float()).abs()
        value_loss = (weight * advantage.square()).mean(dim=1)
        self.values.descend(value_loss)

        with torch.no_grad():
            target = self._target(batch, self.values.first(next_state, no_action))
        losses = self._learn_critics(state, batch, target[:, None])
        self._target_critics.follow(self.critics, config.target_rate)
        return advantage.detach(), losses | {"value": value_loss}
