"""A dataset in memory: its episodes, and flat views of their transitions.

One set of arrays holds everything; episodes, and what an agent sees and sets, are views
of it. Only an observation whose entries do not follow one another in the joint state is
a copy.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.datasets import shipped
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.datasets.card import card, card_html
from marl_mm.datasets.location import SHIPPED, Location, find, locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import read_arrays, read_metadata
from marl_mm.episode import Episode
from marl_mm.layout import columns


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

    def __repr__(self) -> str:
        sizes = self.observation.shape[1], self.action.shape[1]
        return f"<Transitions: {len(self)} steps, observation and action of {sizes}>"

    def part(
        self, observation: tuple[int, ...], action: tuple[int, ...]
    ) -> "Transitions":
        """Some entries of observation and action, everything else shared."""
        return Transitions(
            self.observation[:, columns(observation)],
            self.action[:, columns(action)],
            self.reward,
            self.next_observation[:, columns(observation)],
            self.terminated,
            self.truncated,
            self.episode,
        )


@dataclass(frozen=True)
class Dataset:
    """Episodes with their metadata."""

    location: Location
    metadata: dict[str, Any]
    arrays: EpisodeArrays

    def __repr__(self) -> str:
        count, steps = len(self.arrays), self.arrays.steps
        return f"<Dataset {self.location.folder}: {steps} steps, {count} episodes>"

    def _repr_html_(self) -> str:
        """The card with its figure, for notebooks."""
        return card_html(self)

    def card(self) -> dict[str, Any]:
        """Contents in numbers: size, success, lengths, returns, alphas, coverage.

        JSON-serialisable; lengths in steps.
        """
        return card(self)

    @cached_property
    def provenance(self) -> Provenance:
        """Where the episodes come from.

        Raises:
            DatasetError: If the metadata do not say what they must.
        """
        return Provenance.from_json(self.metadata["marl_mm"])

    @cached_property
    def episodes(self) -> list[Episode]:
        """In order; their arrays are views."""
        return [self.arrays.episode(number) for number in range(len(self.arrays))]

    @cached_property
    def _joint(self) -> Transitions:
        arrays = self.arrays
        return Transitions(
            arrays.states[~arrays.is_last_state()],
            arrays.actions,
            arrays.rewards,
            arrays.states[~arrays.is_first_state()],
            arrays.terminated,
            arrays.truncated,
            arrays.step_episode(),
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
        """Joint states and joint actions."""
        return self._joint

    def agents(self) -> dict[str, Transitions]:
        """Each agent's own observation and action, in the order of the agents."""
        return {
            agent.name: self._joint.part(agent.observation, agent.action)
            for agent in self.arrays.layout.agents
        }


def load_dataset(name: str | Path | Location) -> Dataset:
    """Read a dataset by id or path.

    Args:
        name: An id such as ``marl_mm/reach/pd-v0``, a short one such as ``pd``, a path,
            or a location.

    Raises:
        UnknownDatasetError: If there is none; the message names similar ones.
        DatasetError: If its files are damaged.
    """
    location = name if isinstance(name, Location) else existing(str(name))
    metadata = read_metadata(location)
    return Dataset(location, metadata, read_arrays(location, metadata))


def existing(text: str) -> Location:
    """Where a dataset to read is; the one that ships is unpacked at its first use."""
    location = find(text)
    if location == locate(SHIPPED) and not location.folder.exists():
        shipped.install(location)
    return location
