"""Base of offline algorithms with critics: their targets, steps and diagnostics."""

from collections.abc import Sequence
from typing import Any

import torch

from marl_mm.algorithms.diagnostics import DIAGNOSED, value_slope
from marl_mm.algorithms.networks import PLAIN, Form
from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.offline_learner import OfflineLearner
from marl_mm.algorithms.replay import Judge, highest_target
from marl_mm.algorithms.seeded import SeededCritics
from marl_mm.datasets.arrays import EpisodeArrays


class CriticLearner(OfflineLearner):
    """Learns critics of joint actions beside its actors, for several seeds at once.

    Args:
        config: Hyper-parameters, of a ``CriticConfig`` or with the same names.
        arrays: The dataset's episodes.
        judge: The task's reward and termination.
        seeds: Seeds of initial weights and batches, S of them.
        device: "cpu" or "cuda".
        rates: Learning rates of actors and critics; default ``learning_rate``.
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
        rates: tuple[float, float] | None = None,
        form: Form = PLAIN,
        extra: int = 0,
    ) -> None:
        actors_rate, rate = rates or (config.learning_rate, config.learning_rate)
        super().__init__(
            config,
            arrays,
            judge,
            seeds,
            device,
            rate=actors_rate,
            form=form,
            extra=extra,
            discount=config.discount,
        )
        self.critics = SeededCritics(
            len(self.layout.state) + form.chunk * len(self.layout.action),
            self._pairs(),
            config.hidden,
            config.layer_norm,
            rate,
            seeds,
            device,
        )
        self._target_critics = self.critics.copy()
        self._parts |= {"critics": self.critics, "target_critics": self._target_critics}
        self._highest_target = highest_target(judge, config.clip_targets)

    @property
    def bounds(self) -> dict[str, float]:
        """Divergence bounds: a hundred times what any return can be."""
        if not (largest := self._batches.largest_reward):  # which says nothing
            return {}
        largest /= max(1 - self.config.discount, 1e-3)
        return dict.fromkeys(("q/data", "q/policy", "q/largest"), 100 * largest)

    def _pairs(self) -> int:
        """Pairs of critics that each seed has."""
        return 1

    def _target(self, batch: OfflineBatch, value: torch.Tensor) -> torch.Tensor:
        """Targets of critics: reward and discounted value after the step or chunk.

        Args:
            batch: Transitions.
            value: Value of the state after each, shape (S, ..., B).
        """
        shape = (len(value), *(1,) * (value.dim() - 2), value.shape[-1])
        alive = (batch.discount * (1 - batch.terminated)).view(shape)
        target: torch.Tensor = batch.reward.view(shape) + alive * value
        return target.clamp_max_(self._highest_target)

    def _learn_critics(
        self, state: torch.Tensor, batch: OfflineBatch, target: torch.Tensor
    ) -> dict[str, torch.Tensor]:
        """One gradient step of the critics; losses of each seed, shape (S,).

        Args:
            state: Normalised joint states, shape (S, B, d).
            batch: Transitions.
            target: Targets of the values, shape (S, pairs, B).
        """
        errors = self.critics.values(state, batch.action) - target[:, :, None]
        loss = errors.square().mean(dim=3).sum(dim=(1, 2))
        self.critics.descend(loss)
        return {"critic": loss}

    @torch.no_grad()
    def diagnose(self) -> dict[str, torch.Tensor]:
        """Values and actions on some of the data, shape (S,).

        Q is the first critic's, whatever actors follow; ``q/largest`` the farthest from
        0 of any, at the actors' actions; ``q/slope`` see ``value_slope``.
        """
        state, action = self._batches.some(DIAGNOSED)
        inputs = self.normalizer(state).expand(len(self.seeds), -1, -1)
        action = action.expand(len(self.seeds), -1, -1)
        now = self._acted(inputs)
        return {
            "q/data": self.critics.first(inputs, action).mean(dim=1),
            "q/policy": self.critics.first(inputs, now).mean(dim=1),
            "q/largest": self.critics.values(inputs, now).abs().amax(dim=(1, 2, 3)),
            **value_slope(self.critics, state, inputs, action, self.layout),
            **super().diagnose(),
        }
