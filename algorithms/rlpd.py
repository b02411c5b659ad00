"""RLPD (Ball 2023): online learning whose batches are half a dataset's.

Loss of E critics: (Q_j(s, a) - r - gamma (1 - terminated) min_{m in M} Q_m'(s', a'))^2,
where M is a random pair of critics, drawn at every update, and a' is the target actors'
action with clipped noise. Every second update each actor follows:
-mean_j Q_j(s, (pi_i(o_i), a_-i)) + c mean pi_i(o_i)^2, where a_-i is what the others
would do now. Critics are of the joint state and action, with normalised layers.

Nothing holds actors to the data: what they do elsewhere is corrected by own episodes,
see ``fine_tune``. The source's actor is SAC's, here it is TD3's.
"""

from collections.abc import Sequence
from typing import ClassVar

import torch

from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.rlpd_config import RlpdConfig
from marl_mm.algorithms.seeded import TWINS
from marl_mm.algorithms.td3 import Td3Learner
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import columns


class Rlpd(Td3Learner):
    """Actors and many critics, with targets; see ``Td3Learner``."""

    name: ClassVar[str] = "rlpd"
    config: RlpdConfig

    # --- Update --------------------------------------------------------------

    def _next_value(
        self, state: torch.Tensor, action: torch.Tensor, batch: OfflineBatch
    ) -> torch.Tensor:
        """Lower value of the next state by two critics, shape (S, 1, B)."""
        values = self._target_critics.values(state, action).flatten(1, 2)
        # Ranks of independent noise: a random pair of different critics.
        pair = batch.extra[:, 0].topk(TWINS, dim=1).indices
        seed = torch.arange(len(values), device=values.device)[:, None]
        return values[seed, pair].amin(dim=1, keepdim=True)

    def _improve(
        self, state: torch.Tensor, batch: OfflineBatch
    ) -> dict[str, torch.Tensor]:
        """One gradient step of every actor."""
        losses = {}
        with torch.no_grad():
            now = self.actors.joint(state)
        for agent in self.layouts:
            output, action = self.actors.action(agent.name, state), now.clone()
            action[..., columns(agent.action)] = output
            value = self.critics.values(state, action).mean(dim=(1, 2, 3))
            penalty = self.config.action_penalty * output.square().mean(dim=(1, 2))
            self.actors.descend(agent.name, penalty - value)
            losses[agent.name] = penalty - value
        return losses

    # --- Networks ------------------------------------------------------------

    def __init__(
        self,
        config: RlpdConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        super().__init__(config, arrays, judge, seeds, device, extra=config.critics)

    def _pairs(self) -> int:
        return self.config.critics // TWINS


class MaRlpd(Rlpd):
    """The same with an actor for each agent."""

    name: ClassVar[str] = "ma-rlpd"
    team = True
