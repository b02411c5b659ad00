"""MABC, multi-agent behaviour cloning (paper, Sec. 4.4, Algorithm 2).

Two decentralised actors, each on its own observation, no critic:
loss_i = MSE(a_i, pi_i(o_i)).
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.networks import DIAGNOSED, Normalizer
from marl_mm.algorithms.offline_batches import OfflineBatches
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.seeded import (
    SeededActors,
    imitation_errors,
    load_parts,
    parts_state,
)
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import columns


class Mabc:
    """Trains one actor per agent by supervised learning, for several seeds at once.

    Args:
        config: Hyper-parameters.
        arrays: The dataset's episodes.
        judge: The task's reward and termination; nothing here depends on it.
        seeds: Of initial weights and batches, S of them.
        device: "cpu" or "cuda".
    """

    name: ClassVar[str] = "mabc"

    def __init__(
        self,
        config: MabcConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        self.config, self.seeds, self.step = config, tuple(seeds), 0
        self.layout = arrays.layout
        self.layouts = self.layout.agents
        self.bounds: dict[str, float] = {}
        shares = config.future, 0.0
        self._batches = OfflineBatches(
            arrays, config.batch_size, shares, judge, seeds, device
        )
        # --- Networks --------------------------------------------------------
        states = torch.from_numpy(arrays.states).float()
        self.normalizer = Normalizer.of(states, config.std_floor).to(device)
        self.actors = SeededActors(
            self.layouts,
            self.normalizer,
            config.hidden,
            config.learning_rate,
            seeds,
            device,
        )

    # --- Update --------------------------------------------------------------

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step of every actor; losses of each seed, shape (S,)."""
        batch = self._batches.next()
        self.step += 1
        state = self.normalizer(batch.observation)
        losses = {}
        for agent in self.layouts:
            own = self.actors.own(agent.name, state)
            error = (own - batch.action[..., columns(agent.action)]).square()
            loss = error.mean(dim=(1, 2))
            self.actors.descend(agent.name, loss)
            losses[f"loss/{agent.name}"] = loss.detach()
        return losses

    @torch.no_grad()
    def diagnose(self) -> dict[str, torch.Tensor]:
        """How far the actors are from some of the data, shape (S,)."""
        state, action = self._batches.some(DIAGNOSED)
        inputs = self.normalizer(state).expand(len(self.seeds), -1, -1)
        return imitation_errors(self.actors.joint(inputs), action, self.layout)

    # --- Act -----------------------------------------------------------------

    def agents(self, number: int) -> dict[str, AgentActor]:
        """One seed's actors as they are now."""
        return self.actors.agents(number)

    # --- State ---------------------------------------------------------------

    def state(self, number: int) -> dict[str, Any]:
        """Everything that one seed needs to act and to resume bit-equally."""
        own = parts_state({"actors": self.actors}, number)
        return {"step": self.step, **own, "batches": self._batches.state(number)}

    def load_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Continue all seeds from their ``state``."""
        self.step = states[0]["step"]
        load_parts({"actors": self.actors}, states)
        self._batches.load_states([state["batches"] for state in states])
