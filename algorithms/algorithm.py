"""Interfaces of an algorithm to training loop and checkpoints."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol

import torch

from marl_mm.algorithms.actors import AgentActor
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import Layout


class Resumable(Protocol):
    """An algorithm that a checkpoint can hold."""

    name: str
    """Registered name."""

    layout: Layout
    """Layout of joint states and actions."""

    agents: dict[str, AgentActor]
    """Current actors by name."""

    @property
    def config(self) -> Any:
        """Hyper-parameters, a frozen dataclass."""

    def state(self) -> dict[str, Any]:
        """State with which it acts and resumes bit-equally."""

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a ``state``."""


class OfflineAlgorithm(Protocol):
    """An offline algorithm in training, for several seeds at once."""

    name: ClassVar[str]
    """Registered name."""

    seeds: tuple[int, ...]
    """Seeds of the S runs."""

    layout: Layout
    """Layout of joint states and actions."""

    step: int
    """Number of updates made."""

    @property
    def bounds(self) -> Mapping[str, float]:
        """Divergence bounds: a logged metric beyond its value here stops the run."""

    @property
    def config(self) -> Any:
        """Hyper-parameters, a frozen dataclass with ``updates`` and ``precision``."""

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; metrics of each seed, shape (S,)."""

    def diagnose(self) -> dict[str, torch.Tensor]:
        """Metrics of actors and critics on some of the data, shape (S,)."""

    def agents(self, number: int) -> dict[str, AgentActor]:
        """Current actors of one seed, by name."""

    def state(self, number: int) -> dict[str, Any]:
        """State of one seed, with which it acts and resumes bit-equally."""

    def load_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Continue all seeds from their ``state``."""


class FineTunable(OfflineAlgorithm, Protocol):
    """An offline algorithm that can go on with episodes of its own."""

    @property
    def own(self) -> tuple[int, int]:
        """Numbers of its own episodes, and of their steps."""

    def observe(self, episodes: EpisodeArrays, kept: float) -> None:
        """Add own episodes; a share ``kept`` of what it learns from is the dataset's.

        It has a single seed.
        """
