"""MABC, multi-agent behaviour cloning (paper, Sec. 4.4, Algorithm 2).

Two decentralised actors, each on its own observation, no critic:
loss_i = MSE(a_i, pi_i(o_i)).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.networks import DIAGNOSED, Normalizer
from marl_mm.algorithms.offline_batches import OfflineBatches
from marl_mm.algorithms.registry import ALGORITHMS, PAPER, TUNED, Algorithm
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.seeded import (
    SeededActors,
    imitation_errors,
    load_parts,
    parts_state,
)
from marl_mm.algorithms.speed import Precision
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import columns

# --- Config ------------------------------------------------------------------


@dataclass(frozen=True)
class MabcConfig:
    """Hyper-parameters; the paper's where it names them (Table 3)."""

    updates: int = 8_000
    """Gradient steps per actor; the paper has 100,000 (Table 3). On its datasets but
    the mixes, learning curves are at their end after 5,000 (eval/results/offline)."""

    batch_size: int = 256
    """Transitions per step (Table 3)."""

    learning_rate: float = 5e-4
    """Of Adam (Table 3)."""

    future: float = 0.0
    """Share of transitions whose goal becomes one that their episode came to later."""

    hidden: tuple[int, ...] = (128, 128)
    """Units of each actor's hidden layers; the paper is silent."""

    std_floor: float = 0.01
    """Least standard deviation an observation is scaled by."""

    precision: Precision = "auto"
    """Of products of float32 matrices, as torch has it. With medium they are faster on
    many CPUs and GPUs; where these have units for bfloat16, they are rounded to it.
    With auto it is medium where that is as exact, as a trial at the start shows."""

    def __post_init__(self) -> None:
        positive = ("updates", "batch_size", "learning_rate", "std_floor")
        check_ranges(self, positive, shares=("future",))


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


ALGORITHMS.add(
    "mabc",
    Algorithm(
        about="MABC: behaviour cloning with decentralised actors (paper, Sec. 4.4).",
        source="paper, Sec. 4.4",
        learner=Mabc,
        presets={
            TUNED: MabcConfig(),
            PAPER: MabcConfig(updates=100_000, batch_size=256, learning_rate=5e-4),
        },
    ),
)
