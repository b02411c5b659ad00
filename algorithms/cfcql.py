"""CFCQL, counterfactual conservative Q-learning (Shao 2023), and CQL (Kumar 2020).

Loss of the twin critics: (Q_j(s, a) - r - gamma (1 - terminated) min_j Q_j'(s', a'))^2
+ alpha (sum_i lambda_i log E[exp Q_j(s, (u_i, a_-i)) / q(u_i)] - Q_j(s, a)). Agent i's
actions u_i are drawn from q, half uniform and half Gaussian about its policy's; all
others do what they did in the data. a' is the target actors' action with clipped noise;
lambda_i is the softmax over agents of tau |pi_i(o_i) - a_i|^2, as in the source's code,
whose first version for continuous actions had -tau. Every second update each actor
follows -Q_1(s, (pi_i(o_i), a_-i)) + c mean pi_i(o_i)^2 - b sum log(1 - pi_i(o_i)^2),
over its entries. With one agent it is CQL with an actor of TD3 instead of SAC.

What departs: the source measures the distance from the data in lambda_i by a
variational auto-encoder, trained before. In the loss of an actor its a_-i is from the
data, here what the others would do now: an actor that suits the data's others on the
average may not suit those it will meet. But values where several agents leave the data
at once are not held down. ``others`` chooses. Samples near the policy at s' are left
out, and the conservative term is of a part of the batch. Gaussian samples beyond an
action's bounds are put onto them and keep their density: bounds count more than others.
"""

import math
from collections.abc import Sequence
from typing import ClassVar

import torch

from marl_mm.algorithms.cfcql_config import CfcqlConfig
from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.td3 import Td3Learner
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import AgentLayout, columns


class Cfcql(Td3Learner):
    """Actors and conservative twin critics, with targets; see ``Td3Learner``."""

    name: ClassVar[str] = "cfcql"
    team = True
    config: CfcqlConfig

    # --- Update --------------------------------------------------------------

    def _learn_critics(
        self, state: torch.Tensor, batch: OfflineBatch, target: torch.Tensor
    ) -> dict[str, torch.Tensor]:
        """One gradient step of the critics; losses of each seed, shape (S,)."""
        taken = self.critics.values(state, batch.action)
        error = (taken - target[:, :, None]).square().mean(dim=3).sum(dim=(1, 2))
        some = slice(self.config.penalized)
        excess = self._excess(state[:, some], batch) - taken[:, 0, :, some]
        excess = (excess * batch.imitated[:, None, some]).mean(dim=2).sum(dim=1)
        self.critics.descend(error + self.config.conservatism * excess)
        return {"critic": error, "conservative": excess}

    def _excess(self, state: torch.Tensor, batch: OfflineBatch) -> torch.Tensor:
        """Soft maximum of Q over one agent's actions, weighted over agents.

        The others' actions are the data's. Shapes (S, b, d) to (S, twins, b), of the
        batch's first b transitions.
        """
        each, size = 2 * self.config.samples, state.shape[1]
        action = batch.action[:, :size]
        with torch.no_grad():
            now = self.actors.joint(state)
            drawn, density = self._drawn(now, batch.extra[:, :size])
            asked = action[:, None, None].repeat(1, len(self.layouts), each, 1, 1)
            for number, agent in enumerate(self.layouts):
                own = columns(agent.action)
                asked[:, number, ..., own] = drawn[..., own]
            log_density = self._of_agents(density).movedim(-1, 1)
            away = self._of_agents((now - action).square())
            share = (self.config.focus * away).softmax(dim=-1).movedim(-1, 1)
        states = state[:, None, None].expand(*asked.shape[:-1], -1)
        values = self.critics.values(states.flatten(1, 3), asked.flatten(1, 3))
        values = values.view(len(values), -1, len(self.layouts), each, size)
        count = self.config.samples
        near = self._near(values[:, :, :, count:], batch)
        values = torch.cat([values[:, :, :, :count], near], dim=3)
        excess = (values - log_density[:, None]).logsumexp(dim=3) - math.log(each)
        weighted: torch.Tensor = (share[:, None] * excess).sum(dim=2)
        return weighted

    def _near(self, values: torch.Tensor, batch: OfflineBatch) -> torch.Tensor:
        """Values that actions near the policy's count as, of shape (S, ..., b)."""
        return values

    def _drawn(
        self, now: torch.Tensor, noise: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Actions uniform and near the policy's, and log densities of their entries.

        Args:
            now: The policy's joint actions, shape (S, B, k).
            noise: Standard normal noise, shape (S, B, ...).

        Returns:
            Both of shape (S, 2 samples, B, k).
        """
        count, spread = self.config.samples, self.config.sample_noise
        width = now.shape[-1]
        noise = noise[..., : 2 * count * width]
        noise = noise.reshape(*now.shape[:2], -1, width).transpose(1, 2)
        uniform, near = 2 * torch.special.ndtr(noise[:, :count]) - 1, noise[:, count:]
        density = -near.square() / 2 - math.log(spread * math.sqrt(2 * math.pi))
        near = (now[:, None] + spread * near).clamp_(-1, 1)
        even = torch.full_like(uniform, -math.log(2.0))
        return torch.cat([uniform, near], dim=1), torch.cat([even, density], dim=1)

    def _of_agents(self, entries: torch.Tensor) -> torch.Tensor:
        """Sums of each agent's entries, shapes (..., k) to (..., agents)."""
        sums = [entries[..., columns(a.action)].sum(dim=-1) for a in self.layouts]
        return torch.stack(sums, dim=-1)

    def _improve(
        self, state: torch.Tensor, batch: OfflineBatch
    ) -> dict[str, torch.Tensor]:
        """One gradient step of every actor."""
        losses = {}
        with torch.no_grad():
            others = self.actors.joint(state)
        if self.config.others == "data":
            others = batch.action
        for agent in self.layouts:
            output = self.actors.action(agent.name, state)
            loss = self._actor_loss(agent, state, batch, others, output)
            loss = loss + self.config.action_penalty * output.square().mean(dim=(1, 2))
            if self.config.bound_penalty:
                near = nearness_to_bounds(output).mean(dim=1)
                loss = loss + self.config.bound_penalty * near
            self.actors.descend(agent.name, loss)
            losses[agent.name] = loss
        return losses

    def _actor_loss(
        self,
        agent: AgentLayout,
        state: torch.Tensor,
        batch: OfflineBatch,
        others: torch.Tensor,
        output: torch.Tensor,
    ) -> torch.Tensor:
        """Loss of an agent's actions, shape (S,).

        Args:
            agent: The agent.
            state: Normalised joint states, shape (S, B, d).
            batch: Transitions, with noise.
            others: Joint actions that hold the others' own, shape (S, B, k).
            output: The agent's actions.
        """
        action = others.clone()
        action[..., columns(agent.action)] = output
        return -self.critics.first(state, action).mean(dim=1)

    # --- Networks ------------------------------------------------------------

    def __init__(
        self,
        config: CfcqlConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        extra = self._noise(config) * len(arrays.layout.action)
        super().__init__(config, arrays, judge, seeds, device, extra=extra)

    @staticmethod
    def _noise(config: CfcqlConfig) -> int:
        """Numbers of extra noise for each entry of the action."""
        return 2 * config.samples


def nearness_to_bounds(action: torch.Tensor) -> torch.Tensor:
    """Sum of -log(1 - a^2), at most 14 an entry, shapes (..., k) to (...)."""
    return -torch.log1p(-(1 - 1e-6) * action.square()).sum(dim=-1)


class Cql(Cfcql):
    """The same with one actor that sees and sets everything."""

    name: ClassVar[str] = "cql"
    team = False
