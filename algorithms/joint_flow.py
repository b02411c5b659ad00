"""A flow of joint actions, which teaches actors that act in one step."""

from collections.abc import Sequence
from typing import Any

import torch

from marl_mm.algorithms.flow_bc import flow_errors
from marl_mm.algorithms.networks import Form, Normalizer
from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.seeded import SeededActors
from marl_mm.layout import Layout


class JointFlow(SeededActors):
    """Every seed's flow of joint actions, or of chunks of them.

    Args:
        layout: Layout of the joint state and action.
        normalizer: Normalizer of joint states.
        config: Hyper-parameters with ``hidden``, ``learning_rate``, ``flow_steps``.
        seeds: Seeds of initial weights, S of them.
        device: Device of the networks.
        chunk: Actions in a row that it gives at once, h.
    """

    def __init__(
        self,
        layout: Layout,
        normalizer: Normalizer,
        config: Any,
        seeds: Sequence[int],
        device: str,
        chunk: int = 1,
    ) -> None:
        self._joint = layout.joint
        super().__init__(
            (self._joint,),
            normalizer,
            config.hidden,
            config.learning_rate,
            seeds,
            device,
            Form(noisy=True, flow_steps=config.flow_steps, chunk=chunk),
        )

    def imitate(
        self,
        state: torch.Tensor,
        batch: OfflineBatch,
        noise: torch.Tensor,
        time: torch.Tensor,
    ) -> torch.Tensor:
        """One gradient step towards the data; losses of the seeds, shape (S,).

        Steps beyond an episode's end do not count.

        Args:
            state: Normalised joint states, shape (S, B, d).
            batch: The data.
            noise: Noise where the flow begins, shape (S, B, h k).
            time: Standard normal values that times are made of, shape (S, B, 1).
        """
        ends = batch.action, noise
        errors = flow_errors(self, self._joint, state, *ends, time)
        errors = errors.view(*errors.shape[:2], self.form.chunk, -1).mean(dim=3)
        weight = batch.imitated[..., None] * batch.within
        loss = (weight * errors).mean(dim=(1, 2))
        self.descend(self._joint.name, loss)
        return loss
