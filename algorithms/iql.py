"""IQL, implicit Q-learning (Kostrikov 2022): never asks a critic for unseen actions.

Loss of V: L_tau(min_j Q_j'(s, a) - V(s)), where L_tau(x) = |tau - 1(x < 0)| x^2; of the
twin critics: (Q_j(s, a) - r - gamma (1 - terminated) V(s'))^2; of each actor:
exp(beta (min_j Q_j'(s, a) - V(s))) MSE(a_i, pi_i(o_i)). A team shares V and Q, which
are of the joint state and action; each agent has its own actor.
"""

from collections.abc import Sequence
from typing import ClassVar

import torch

from marl_mm.algorithms.iql_config import IqlConfig
from marl_mm.algorithms.offline_critics import CriticLearner
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.seeded import SeededCritics
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import columns

LARGEST_WEIGHT = 100.0
"""Largest weight of a step in the actors' loss, as in the source's code."""


class Iql(CriticLearner):
    """Actors, values and twin critics; see ``CriticLearner``."""

    name: ClassVar[str] = "iql"
    config: IqlConfig

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; losses of each seed, shape (S,)."""
        config, batch = self.config, self._batches.next()
        self.step += 1
        state, action = self.normalizer(batch.observation), batch.action
        next_state, nothing = self.normalizer(batch.next_observation), action[..., :0]

        with torch.no_grad():
            taken = self._target_critics.least(state, action)[:, 0]
        advantage = taken - self.values.first(state, nothing)
        weight = (config.expectile - (advantage < 0).float()).abs()
        value_loss = (weight * advantage.square()).mean(dim=1)
        self.values.descend(value_loss)

        with torch.no_grad():
            target = self._target(batch, self.values.first(next_state, nothing))
        errors = self.critics.values(state, action) - target[:, None, None]
        critic_loss = errors.square().mean(dim=3).sum(dim=(1, 2))
        self.critics.descend(critic_loss)

        weight = (config.temperature * advantage.detach()).exp()
        weight = weight.clamp_max_(LARGEST_WEIGHT) * batch.imitated
        losses = {"critic": critic_loss, "value": value_loss}
        for agent in self.layouts:
            error = self.actors.action(agent.name, state)
            error = error - action[..., columns(agent.action)]
            loss = (weight * error.square().mean(dim=2)).mean(dim=1)
            self.actors.descend(agent.name, loss)
            losses[agent.name] = loss

        self._target_critics.follow(self.critics, config.target_rate)
        return {f"loss/{name}": loss.detach() for name, loss in losses.items()}

    def __init__(
        self,
        config: IqlConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        super().__init__(config, arrays, judge, seeds, device)
        self.values = SeededCritics(
            len(self.layout.state),
            1,
            config.hidden,
            config.layer_norm,
            config.learning_rate,
            seeds,
            device,
            twins=1,
            stream=3,
        )
        self._parts |= {"values": self.values}


class MaIql(Iql):
    """The same with an actor for each agent."""

    name: ClassVar[str] = "ma-iql"
    team = True
