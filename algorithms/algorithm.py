"""What the training loop and checkpoints need of an algorithm."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol

import torch

from marl_mm.algorithms.actors import AgentActor
from marl_mm.layout import Layout


class Resumable(Protocol):
    """What a checkpoint keeps."""

    name: str
    layout: Layout
    agents: dict[str, AgentActor]
    """The actors as they are now."""

    @property
    def config(self) -> Any:
        """Its hyper-parameters, a frozen dataclass."""

    def state(self) -> dict[str, Any]:
        """Everything that acting and resuming bit-equally need."""

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Continue from another run's state."""


class OfflineAlgorithm(Protocol):
    """An offline algorithm in training, for several seeds at once."""

    name: ClassVar[str]
    seeds: tuple[int, ...]
    layout: Layout
    step: int
    """Updates made."""

    bounds: dict[str, float]
    """Divergence bounds: a logged metric beyond its value here stops the run."""

    @property
    def config(self) -> Any:
        """Its hyper-parameters, with ``updates`` and ``precision``; frozen."""

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; what each seed measured, shape (S,)."""

    def diagnose(self) -> dict[str, torch.Tensor]:
        """What actors and critics do on some of the data, shape (S,)."""

    def agents(self, number: int) -> dict[str, AgentActor]:
        """One seed's actors as they are now."""

    def state(self, number: int) -> dict[str, Any]:
        """Everything that acting and resuming bit-equally need, of one seed."""

    def load_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Continue all seeds from other runs' states."""
