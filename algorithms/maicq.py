"""MAICQ, multi-agent implicit constraint Q-learning (Yang 2021), agent after agent.

Loss of the twin critics: w(s', a') (Q_j(s, a) - r - gamma (1 - terminated)
min_j Q_j'(s', a'))^2, where a' is the data's next action, and w(s', a') the softmax
over the batch of (Q'(s', a') - Q'(s', pi(s'))) / alpha_Q, times its size. Loss of each
actor, one after the other: w_i(s, a) MSE(a_i, pi_i(o_i)), with w_i the same of
A_i / alpha: A_i = Q(s, (pi_<i, a_i, a_>i)) - Q(s, (pi_<i, pi_i, a_>i)). Agents before i
act by their updated actors, those after it as in the data; apart from these updates the
A_i add up to the joint action's advantage. Where a step terminated the critics'
advantage counts as 0.

What departs: the source multiplies the target's Q'(s', a') by w, of Q itself. Its mean
over the batch is 1, but over a state's actions it is not: where rewards are below 0, a
good state seen once is worth less than it is. As a weight of the loss w cancels where a
state has one action, and where it has several it takes their weighted mean, which is
what the source sets out to do. Q is of the joint state and action instead of mixed from
agents' own. A_i follows the order of agents (Kuba 2022); in the source all others act
as in the data. Actors are deterministic: their log-likelihood is the negative square
error. Critics learn from one step's reward, in the source from TD(lambda) returns, and
their targets follow them, in the source they are copied. The last step of an episode
that did not terminate has no next action; its own stands in.
"""

from typing import ClassVar

import torch

from marl_mm.algorithms.maicq_config import MaicqConfig
from marl_mm.algorithms.offline_critics import CriticLearner
from marl_mm.layout import columns

_NOT_IMITATED = -1e9
"""Scaled advantage of steps that are not imitated; finite, so that a batch of nothing
else has no NaN."""


class Maicq(CriticLearner):
    """Actors and in-sample twin critics; see ``CriticLearner``."""

    name: ClassVar[str] = "maicq"
    team = True
    config: MaicqConfig

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; losses of each seed, shape (S,)."""
        config, batch = self.config, self._batches.next()
        self.step += 1
        state, action = self.normalizer(batch.observation), batch.action
        next_state = self.normalizer(batch.next_observation)

        with torch.no_grad():
            value = self._target_critics.least(next_state, batch.next_action)[:, 0]
            target = self._target(batch, value)
            policy = self.actors.joint(next_state)
            gain = value - self._target_critics.least(next_state, policy)[:, 0]
            gain = gain * (1 - batch.terminated)
            weight = softmax_weights(gain / config.critic_temperature)
        errors = self.critics.values(state, action) - target[:, None, None]
        squares = weight[:, None, None] * errors.square()
        critic_loss = squares.mean(dim=3).sum(dim=(1, 2))
        self.critics.descend(critic_loss)

        losses = {"critic": critic_loss}
        mixed = action.clone()  # of agents that have learnt, and of the data
        for agent in self.layouts:
            own = columns(agent.action)
            output = self.actors.action(agent.name, state)
            with torch.no_grad():
                taken = self.critics.least(state, mixed)[:, 0]
                mixed[..., own] = output
                gain = taken - self.critics.least(state, mixed)[:, 0]
                gain = gain / config.temperature
                gain = gain.where(batch.imitated > 0, _NOT_IMITATED)
                weight = softmax_weights(gain) * batch.imitated
            error = (output - action[..., own]).square().mean(dim=2)
            loss = (weight * error).mean(dim=1)
            self.actors.descend(agent.name, loss)
            losses[agent.name] = loss
            with torch.no_grad():
                mixed[..., own] = self.actors.action(agent.name, state)

        self._target_critics.follow(self.critics, config.target_rate)
        return {f"loss/{name}": loss.detach() for name, loss in losses.items()}


def softmax_weights(gain: torch.Tensor) -> torch.Tensor:
    """Softmax over the batch, of mean 1, shapes (S, B) to (S, B)."""
    return gain.softmax(dim=1) * gain.shape[1]
