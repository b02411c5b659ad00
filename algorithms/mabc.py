"""MABC, multi-agent behaviour cloning (paper, Sec. 4.4, Algorithm 2), and BC.

Decentralised actors, each on its own observation, no critic:
loss_i = MSE(a_i, pi_i(o_i)).
"""

from typing import ClassVar

import torch

from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.offline_learner import OfflineLearner


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


class Bc(Mabc):
    """The same with one actor that sees and sets everything."""

    name: ClassVar[str] = "bc"
    team = False
