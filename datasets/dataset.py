"""A dataset in memory: its episodes and flat views of their transitions."""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.datasets.location import Location, locate
from marl_mm.datasets.storage import read_episodes, read_metadata
from marl_mm.episode import Episode
from marl_mm.layout import AGENTS


@dataclass(frozen=True)
class Transitions:
    """Steps of all episodes, one after the other; n of them."""

    observation: np.ndarray
    """Shape (n, d)."""

    action: np.ndarray
    """Shape (n, k), float32."""

    reward: np.ndarray
    """Shape (n,)."""

    next_observation: np.ndarray
    """Shape (n, d)."""

    terminated: np.ndarray
    """Shape (n,), bool."""

    truncated: np.ndarray
    """Shape (n,), bool."""

    episode: np.ndarray
    """Number of each step's episode in the dataset, shape (n,)."""

    def __len__(self) -> int:
        return len(self.reward)

    def part(
        self, observation: tuple[int, ...], action: tuple[int, ...]
    ) -> "Transitions":
        """Some entries of observation and action, everything else shared."""
        return Transitions(
            self.observation[:, list(observation)],
            self.action[:, list(action)],
            self.reward,
            self.next_observation[:, list(observation)],
            self.terminated,
            self.truncated,
            self.episode,
        )


@dataclass(frozen=True)
class Dataset:
    """Episodes with their metadata."""

    location: Location
    metadata: dict[str, Any]
    episodes: list[Episode]

    @cached_property
    def _joint(self) -> Transitions:
        episodes = self.episodes
        lengths = [len(episode) for episode in episodes]
        return Transitions(
            np.concatenate([episode.states[:-1] for episode in episodes]),
            np.concatenate([episode.actions for episode in episodes]),
            np.concatenate([episode.rewards for episode in episodes]),
            np.concatenate([episode.states[1:] for episode in episodes]),
            np.concatenate([episode.terminated for episode in episodes]),
            np.concatenate([episode.truncated for episode in episodes]),
            np.repeat(np.arange(len(episodes)), lengths),
        )

    @cached_property
    def fingerprint(self) -> str:
        """Hash of all observations, actions and rewards."""
        joint, digest = self._joint, hashlib.sha256()
        for array in (joint.observation, joint.action, joint.reward, joint.episode):
            digest.update(array.tobytes())
        return digest.hexdigest()[:16]

    def identity(self) -> dict[str, str]:
        """Which dataset it is, for the config of a run."""
        return {
            "id": self.metadata["dataset_id"],
            "path": str(self.location.folder),
            "fingerprint": self.fingerprint,
        }

    def joint(self) -> Transitions:
        """Joint state (10) and joint action (4)."""
        return self._joint

    def agents(self) -> dict[str, Transitions]:
        """Each agent's own observation and action, in the order of the agents."""
        return {
            agent.name: self._joint.part(agent.observation, agent.action)
            for agent in AGENTS
        }


def load_dataset(name: str | Path | Location) -> Dataset:
    """Read a dataset by id or path.

    Args:
        name: An id such as ``marl_mm/reach/pd-v0``, a path, or a location.

    Raises:
        UnknownDatasetError: If there is none; the message lists the known ids.
        DatasetError: If its files are damaged.
    """
    location = name if isinstance(name, Location) else locate(str(name))
    metadata = read_metadata(location)
    return Dataset(location, metadata, read_episodes(location))
