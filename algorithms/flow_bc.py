"""Cloning by flow matching (Lipman 2023): actors that draw among several ways.

Loss of an actor's velocity v_i: |v_i(o_i, (1 - t) z + t a_i, t) - (a_i - z)|^2, with
noise z and a time t, uniform in [0, 1], of each step. An action is where the velocity
leads from noise in a few Euler steps.
"""

from collections.abc import Sequence
from typing import ClassVar

import torch

from marl_mm.algorithms.flow_bc_config import FlowBcConfig
from marl_mm.algorithms.networks import Form
from marl_mm.algorithms.offline_learner import OfflineLearner
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.seeded import SeededActors
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import AgentLayout


def flow_errors(
    actors: SeededActors,
    agent: AgentLayout,
    state: torch.Tensor,
    action: torch.Tensor,
    noise: torch.Tensor,
    time: torch.Tensor,
) -> torch.Tensor:
    """Squared errors of an agent's velocities, shape (S, B, k).

    Args:
        actors: Flows.
        agent: Agent.
        state: Normalised joint states, shape (S, B, d).
        action: The agent's actions in [-1, 1], where the flow ends, shape (S, B, k).
        noise: Noise where it begins, likewise.
        time: Standard normal values that times are made of, shape (S, B, 1).
    """
    time = torch.special.ndtr(time)  # uniform in [0, 1]
    point = torch.lerp(noise, action, time)
    inputs = torch.cat([actors.observed(agent.name, state), point, time], dim=-1)
    velocity = actors.networks[agent.name](inputs)
    return (velocity - (action - noise)).square()


class FlowBc(OfflineLearner):
    """Flows by supervised learning; see ``OfflineLearner``."""

    name: ClassVar[str] = "flow-bc"
    config: FlowBcConfig

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step of every actor; losses of each seed, shape (S,)."""
        batch, losses = self._batches.next(), {}
        self.step += 1
        state = self.normalizer(batch.observation)
        for agent in self.layouts:
            own = self.actors.entries(agent)
            ends = batch.action[..., own], batch.noise[..., own]
            errors = flow_errors(self.actors, agent, state, *ends, batch.extra)
            loss = errors.mean(dim=2).mean(dim=1)
            self.actors.descend(agent.name, loss)
            losses[f"loss/{agent.name}"] = loss.detach()
        return losses

    def __init__(
        self,
        config: FlowBcConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        super().__init__(
            config,
            arrays,
            judge,
            seeds,
            device,
            rate=config.learning_rate,
            form=Form(noisy=True, flow_steps=config.flow_steps),
            extra=1,
        )


class MaFlowBc(FlowBc):
    """The same with a flow for each agent."""

    name: ClassVar[str] = "ma-flow-bc"
    team = True
