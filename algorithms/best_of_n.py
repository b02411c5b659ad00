"""Best-of-n students, ours: decentralised actors clone what a critic picks of a flow.

Loss of the joint flow: |v(s, (1 - t) z + t a, t) - (a - z)|^2, see ``flow_bc``; of V
and the twin critics: in-sample, see ``in_sample``. At each state the flow proposes n
joint actions, and the target critics' minimum picks a*. Loss of each actor, without
noise: MSE(a*_i, pi_i(o_i)). Where the data show several conventions, the value breaks
the tie once for all agents; where values are equal, only the critics' errors do.

What is not ours: to propose by a generative model of the data and pick by a critic is
SfBC's (Chen 2023, arXiv 2209.14548) and, with IQL's values, IDQL's (Hansen-Estruch
2023, arXiv 2304.10573), both in every step of acting and by one agent; BCQ (Fujimoto
2019) did so before with a variational autoencoder. To distil a joint flow into an actor
per agent is MAC-Flow's (Lee 2025), which does not pick; VGM2P (Pang 2026, arXiv
2604.08174) tells a team's flow the team's advantage instead of picking.
"""

from collections.abc import Sequence
from typing import ClassVar

import torch

from marl_mm.algorithms.best_of_n_config import BestOfNConfig
from marl_mm.algorithms.in_sample import InSampleLearner
from marl_mm.algorithms.joint_flow import JointFlow
from marl_mm.algorithms.replay import Judge
from marl_mm.datasets.arrays import EpisodeArrays


class BestOfN(InSampleLearner):
    """Actors of agents, a flow of joint actions, values and twin critics."""

    name: ClassVar[str] = "best-of-n"
    team = True
    config: BestOfNConfig

    # --- Update --------------------------------------------------------------

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; losses of each seed, shape (S,)."""
        batch = self._batches.next()
        self.step += 1
        state = self.normalizer(batch.observation)
        some = slice(self.config.picked)
        time, proposing = batch.extra[..., :1], batch.extra[:, some, 1:]

        _, losses = self._learn_values(state, batch)
        losses["flow"] = self.flow.imitate(state, batch, batch.noise, time)
        state, imitated = state[:, some], batch.imitated[:, some]
        losses |= self._imitate(state, self._picked(state, proposing), imitated)
        return {f"loss/{name}": loss.detach() for name, loss in losses.items()}

    @torch.no_grad()
    def _picked(self, state: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """Best joint action of n that the flow proposes, shape (S, b, k).

        Args:
            state: Normalised joint states, shape (S, b, d).
            noise: Where the flow begins, shape (S, b, n k).
        """
        samples = self.config.samples
        many = state.repeat_interleave(samples, dim=1)
        seeds, size, _ = state.shape
        begin = noise.reshape(seeds, size * samples, -1)
        action = self.flow.joint(many, begin)
        value = self._target_critics.least(many, action)[:, 0]
        best = value.view(seeds, size, samples).argmax(dim=2)
        proposed = action.view(seeds, size, samples, -1)
        return torch.take_along_dim(proposed, best[..., None, None], dim=2).squeeze(2)

    # --- Networks ------------------------------------------------------------

    def __init__(
        self,
        config: BestOfNConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        extra = config.samples * len(arrays.layout.action) + 1
        super().__init__(config, arrays, judge, seeds, device, extra=extra)
        self.flow = JointFlow(self.layout, self.normalizer, config, seeds, device)
        self._parts |= {"flow": self.flow}


class BestOfNJoint(BestOfN):
    """The same with one actor that sees and sets everything."""

    name: ClassVar[str] = "best-of-n-joint"
    team = False
