"""MABC, multi-agent behaviour cloning (paper, Sec. 4.4, Algorithm 2), and BC.

Decentralised actors, each on its own observation, no critic:
loss_i = MSE(a_i, pi_i(o_i)).
"""

from collections.abc import Sequence
from typing import ClassVar

import torch

from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.offline_learner import OfflineLearner
from marl_mm.algorithms.replay import Judge
from marl_mm.datasets.arrays import EpisodeArrays


class Mabc(OfflineLearner):
    """One actor per agent by supervised learning; see ``OfflineLearner``."""

    name: ClassVar[str] = "mabc"
    team = True
    config: MabcConfig

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step of every actor; losses of each seed, shape (S,)."""
        batch = self._batches.next()
        self.step += 1
        state = self.normalizer(batch.observation)
        losses = self._imitate(state, batch.action, batch.imitated)
        return {f"loss/{name}": loss.detach() for name, loss in losses.items()}

    def __init__(
        self,
        config: MabcConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        shares = config.future, 0.0
        super().__init__(config, arrays, judge, seeds, device, shares=shares)


class Bc(Mabc):
    """The same with one actor that sees and sets everything."""

    name: ClassVar[str] = "bc"
    team = False
