"""FQL, flow Q-learning (Park 2025): a one-step actor between a flow and a critic.

Loss of the flow, the teacher: |v(s, (1 - t) z + t a, t) - (a - z)|^2, see ``flow_bc``;
of the twin critics: (Q_j(s, a) - r - gamma (1 - terminated) mean_j Q_j'(s', a'))^2,
where a' is the actor's action by fresh noise, without a target actor; of each actor:
-lambda mean_j Q_j(s, (pi_i(o_i, z_i), a_-i)) + alpha MSE(teacher(s, z)_i,
pi_i(o_i, z_i)), lambda = 1 / mean |Q|, where a_-i is what the others do by their own
part of the noise z.

Ours: actions of the actor end in a tanh, where the source clips them; lambda is always
there, which the source makes an option; each network has an optimiser of its own.
"""

from collections.abc import Sequence
from typing import ClassVar

import torch

from marl_mm.algorithms.fql_config import FqlConfig
from marl_mm.algorithms.joint_flow import JointFlow
from marl_mm.algorithms.networks import Form
from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.offline_critics import CriticLearner
from marl_mm.algorithms.replay import Judge
from marl_mm.datasets.arrays import EpisodeArrays


class Fql(CriticLearner):
    """One-step actors, a flow of joint actions and twin critics.

    Args:
        config: Hyper-parameters.
        arrays: The dataset's episodes.
        judge: The task's reward and termination.
        seeds: Seeds of initial weights and batches, S of them.
        device: "cpu" or "cuda".
        chunk: Actions in a row that are one, h.
    """

    name: ClassVar[str] = "fql"
    config: FqlConfig

    # --- Update --------------------------------------------------------------

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; losses of each seed, shape (S,)."""
        batch = self._batches.next()
        self.step += 1
        state = self.normalizer(batch.observation)
        width = batch.action.shape[-1]
        begin, noise, time = torch.split(batch.extra, [width, width, 1], -1)

        losses = {"flow": self.flow.imitate(state, batch, begin, time)}
        losses |= self._learn_critics(state, batch, self._next_target(batch))
        losses |= self._improve(state, noise, batch.imitated)
        self._target_critics.follow(self.critics, self.config.target_rate)
        return {f"loss/{name}": loss.detach() for name, loss in losses.items()}

    @torch.no_grad()
    def _next_target(self, batch: OfflineBatch) -> torch.Tensor:
        """Targets by the mean of the twin critics, shape (S, 1, B)."""
        next_state = self.normalizer(batch.next_observation)
        next_action = self.actors.joint(next_state, batch.noise)
        value = self._target_critics.values(next_state, next_action)
        return self._target(batch, value.mean(dim=2))

    def _improve(
        self, state: torch.Tensor, noise: torch.Tensor, imitated: torch.Tensor
    ) -> dict[str, torch.Tensor]:
        """One gradient step of every actor."""
        losses: dict[str, torch.Tensor] = {}
        with torch.no_grad():
            taught = self.flow.joint(state, noise)
            now = self.actors.joint(state, noise)
        for agent in self.layouts:
            own = self.actors.entries(agent)
            output = self.actors.action(agent.name, state, noise[..., own])
            action = now.clone()
            action[..., own] = output
            value = self.critics.values(state, action)[:, 0].mean(dim=1)
            error = (output - taught[..., own]).square() * imitated[..., None]
            error = error.mean(dim=(1, 2))
            scale = value.detach().abs().mean(dim=1)
            loss = self.config.distillation * error - value.mean(dim=1) / scale
            self.actors.descend(agent.name, loss)
            losses |= {agent.name: loss, f"distillation/{agent.name}": error}
        return losses

    # --- Networks ------------------------------------------------------------

    def __init__(
        self,
        config: FqlConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
        *,
        chunk: int = 1,
    ) -> None:
        form = Form(noisy=True, chunk=chunk)
        extra = 2 * chunk * len(arrays.layout.action) + 1
        super().__init__(config, arrays, judge, seeds, device, form=form, extra=extra)
        self.flow = JointFlow(
            self.layout, self.normalizer, config, seeds, device, chunk
        )
        self._parts |= {"flow": self.flow}
