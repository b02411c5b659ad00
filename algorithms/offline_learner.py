"""Base of offline algorithms: batches, input statistics, actors and their state."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import torch

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.diagnostics import DIAGNOSED, imitation_errors
from marl_mm.algorithms.networks import PLAIN, Form, Normalizer
from marl_mm.algorithms.offline_batches import OfflineBatches
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.seeded import Part, SeededActors, load_parts, parts_state
from marl_mm.algorithms.speed import resolved
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import AgentLayout, columns


class OfflineLearner:
    """Learns from a dataset's transitions, for several seeds at once.

    Args:
        config: Hyper-parameters, with ``batch_size``, ``hidden`` and ``std_floor``, and
            ``future`` and ``elsewhere`` where some goals are exchanged.
        arrays: The dataset's episodes.
        judge: The task's reward and termination.
        seeds: Seeds of initial weights and batches, S of them.
        device: "cpu" or "cuda".
        rate: Learning rate of the actors; default the config's ``learning_rate``.
        form: Form of the actors' networks.
        extra: Entries of noise that batches have beside the usual.
        discount: Discount of rewards per step.
    """

    team: ClassVar[bool] = False
    """Whether each agent has an actor of its own; or one sees and sets everything."""

    def __init__(
        self,
        config: Any,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
        rate: float | None = None,
        form: Form = PLAIN,
        extra: int = 0,
        discount: float = 1.0,
    ) -> None:
        self.config = replace(config, precision=resolved(config.precision, device))
        self.seeds, self.step = tuple(seeds), 0
        self.layout = arrays.layout
        self.layouts = self._layouts()
        """Layouts of the actors."""

        self._batches = OfflineBatches(
            arrays,
            config.batch_size,
            (getattr(config, "future", 0.0), getattr(config, "elsewhere", 0.0)),
            judge,
            seeds,
            device,
            extra=extra,
            chunk=form.chunk,
            discount=discount,
        )
        states = torch.from_numpy(arrays.states).float()
        self.normalizer = Normalizer.of(states, config.std_floor).to(device)
        self.actors = SeededActors(
            self.layouts,
            self.normalizer,
            config.hidden,
            config.learning_rate if rate is None else rate,
            seeds,
            device,
            form,
        )
        self._parts: dict[str, Part] = {"actors": self.actors}
        """Networks by their name in the state."""

    def _layouts(self) -> tuple[AgentLayout, ...]:
        return self.layout.agents if self.team else (self.layout.joint,)

    def _imitate(
        self, state: torch.Tensor, action: torch.Tensor, weight: torch.Tensor
    ) -> dict[str, torch.Tensor]:
        """One gradient step of every actor towards actions; losses of shape (S,).

        Args:
            state: Normalised joint states, shape (S, B, d).
            action: Joint actions in [-1, 1], shape (S, B, k).
            weight: Weight of each step's mean square error, shape (S, B).
        """
        losses = {}
        for agent in self.layouts:
            error = self.actors.action(agent.name, state)
            error = error - action[..., columns(agent.action)]
            loss = (weight * error.square().mean(dim=2)).mean(dim=1)
            self.actors.descend(agent.name, loss)
            losses[agent.name] = loss
        return losses

    def _acted(self, inputs: torch.Tensor) -> torch.Tensor:
        """Joint actions at normalised joint states, by noise that is always the same.

        Shapes (S, n, d) to (S, n, h k).
        """
        noise = None
        if self.actors.form.noisy:
            width = self.actors.form.chunk * len(self.layout.action)
            shape = inputs.shape[1], width
            drawn = np.random.default_rng(0).standard_normal(shape, np.float32)
            noise = torch.from_numpy(drawn).to(inputs.device)
            noise = noise.expand(len(inputs), -1, -1)
        return self.actors.joint(inputs, noise)

    @torch.no_grad()
    def diagnose(self) -> dict[str, torch.Tensor]:
        """Distance of the actors from some of the data, shape (S,)."""
        state, action = self._batches.some(DIAGNOSED)
        inputs = self.normalizer(state).expand(len(self.seeds), -1, -1)
        return imitation_errors(self._acted(inputs), action, self.layout)

    @property
    def own(self) -> tuple[int, int]:
        """Numbers of its own episodes, and of their steps."""
        return self._batches.own

    def observe(self, episodes: EpisodeArrays, kept: float) -> None:
        """Add own episodes; see ``FineTunable``."""
        self._batches.add(episodes, kept)

    @property
    def bounds(self) -> dict[str, float]:
        """Divergence bounds: none."""
        return {}

    def agents(self, number: int) -> dict[str, AgentActor]:
        """Current actors of one seed, by name."""
        return self.actors.agents(number)

    def state(self, number: int) -> dict[str, Any]:
        """State of one seed, with which it acts and resumes bit-equally."""
        parts = parts_state(self._parts, number)
        return {"step": self.step, **parts, "batches": self._batches.state(number)}

    def load_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Continue all seeds from their ``state``."""
        self.step = states[0]["step"]
        load_parts(self._parts, states)
        self._batches.load_states([state["batches"] for state in states])
