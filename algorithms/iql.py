"""IQL, implicit Q-learning (Kostrikov 2022): never asks a critic for unseen actions.

V and the twin critics learn in-sample, see ``in_sample``. Loss of each actor:
min(exp(beta (min_j Q_j'(s, a) - V(s))), 100) MSE(a_i, pi_i(o_i)). A team shares V and
Q, which are of the joint state and action; each agent has its own actor.
"""

from typing import ClassVar

import torch

from marl_mm.algorithms.in_sample import InSampleLearner
from marl_mm.algorithms.iql_config import IqlConfig

LARGEST_WEIGHT = 100.0
"""Largest weight of a step in the actors' loss, as in the source's code."""


class Iql(InSampleLearner):
    """Actors, values and twin critics; see ``InSampleLearner``."""

    name: ClassVar[str] = "iql"
    config: IqlConfig

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; losses of each seed, shape (S,)."""
        batch = self._batches.next()
        self.step += 1
        state = self.normalizer(batch.observation)
        advantage, losses = self._learn_values(state, batch)

        weight = (self.config.temperature * advantage).exp()
        weight = weight.clamp_max_(LARGEST_WEIGHT) * batch.imitated
        losses |= self._imitate(state, batch.action, weight)
        return {f"loss/{name}": loss.detach() for name, loss in losses.items()}


class MaIql(Iql):
    """The same with an actor for each agent."""

    name: ClassVar[str] = "ma-iql"
    team = True
