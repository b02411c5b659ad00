"""What the training loop and checkpoints need of an algorithm."""

from collections.abc import Mapping
from typing import Any, Protocol

from marl_mm.algorithms.actors import AgentActor


class AlgorithmConfig(Protocol):
    """Hyper-parameters, a frozen dataclass."""

    @property
    def updates(self) -> int:
        """Gradient steps in all."""


class Resumable(Protocol):
    """What a checkpoint keeps."""

    name: str
    agents: dict[str, AgentActor]
    """The actors as they are now."""

    @property
    def config(self) -> Any:
        """Its hyper-parameters, a frozen dataclass."""

    def state(self) -> dict[str, Any]:
        """Everything that acting and resuming bit-equally need."""

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Continue from another run's state."""


class Algorithm(Resumable, Protocol):
    """An offline algorithm in training."""

    step: int
    """Updates made."""

    @property
    def config(self) -> AlgorithmConfig:
        """Its hyper-parameters."""

    def update(self) -> dict[str, float]:
        """One gradient step; what it measured."""
