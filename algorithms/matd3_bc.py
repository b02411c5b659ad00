"""MATD3+BC (paper, Algorithm 2; Pan 2022): TD3+BC with an actor per agent.

Actors see their own observations only; their twin critics, in training only, see the
joint state and action. Loss of agent i's actor: -lambda_i Q_i(s, (pi_i(o_i), a_-i))
+ MSE(a_i, pi_i(o_i)), where a_-i is what the others did or would do now.
"""

from typing import ClassVar

import torch

from marl_mm.algorithms.matd3_bc_config import Matd3BcConfig
from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.td3_bc import Td3Bc
from marl_mm.layout import columns


class Matd3Bc(Td3Bc):
    """Learns decentralised actors with centralised critics; see ``Td3Bc``."""

    name: ClassVar[str] = "matd3-bc"
    team = True
    config: Matd3BcConfig

    def _pairs(self) -> int:
        """One pair of critics for each agent, or one for all."""
        return len(self.layouts) if self.config.critics == "own" else 1

    # --- Update --------------------------------------------------------------

    def _improve(
        self, state: torch.Tensor, batch: OfflineBatch
    ) -> dict[str, torch.Tensor]:
        """One gradient step of every actor."""
        losses = {}
        policies = self.config.others == "policy"
        with torch.no_grad():  # before any agent's step: their order does not matter
            others = self.actors.joint(state) if policies else batch.action
        for number, agent in enumerate(self.layouts):
            entries = columns(agent.action)
            pair = number if self.config.critics == "own" else 0
            action = others.clone()
            action[..., entries] = self.actors.action(agent.name, state)
            value = self.critics.first(state, action, pair)
            error = self._imitation.error(action, state, batch, value, entries, pair)
            loss = error - self._lambda(value) * value.mean(dim=1)
            self.actors.descend(agent.name, loss)
            losses[agent.name] = loss
            losses[f"imitation/{agent.name}"] = error
        return losses
