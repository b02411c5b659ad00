"""A dataset in memory: its episodes, and flat views of their transitions.

One set of arrays holds everything. Episodes, and observations and actions of agents,
are views of it, except for observations whose entries are not consecutive in the joint
state: these are copies.
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
from marl_mm.datasets.location import Location, find, locate, text_of
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import read_arrays
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.layout import columns


@dataclass(frozen=True, eq=False)
class Transitions:
    """The n steps of all episodes, one after the other."""

    observation: np.ndarray
    """Observations before the steps, shape (n, d)."""

    action: np.ndarray
    """Actions, shape (n, k), float32."""

    reward: np.ndarray
    """Rewards, shape (n,)."""

    next_observation: np.ndarray
    """Observations after the steps, shape (n, d)."""

    terminated: np.ndarray
    """Whether a step reached the goal or failed, shape (n,), bool."""

    truncated: np.ndarray
    """Whether the episode ran out of steps, shape (n,), bool."""

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
        """The transitions with some entries of observation and action only."""
        return Transitions(
            self.observation[:, columns(observation)],
            self.action[:, columns(action)],
            self.reward,
            self.next_observation[:, columns(observation)],
            self.terminated,
            self.truncated,
            self.episode,
        )


@dataclass(frozen=True, eq=False)
class Dataset:
    """Episodes with their metadata."""

    location: Location
    """Id and folder."""

    metadata: dict[str, Any]
    """Metadata of Minari, and ours under the key ``marl_mm``."""

    arrays: EpisodeArrays
    """Arrays of all episodes."""

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
        """The record of where the episodes come from.

        Raises:
            DatasetError: If the metadata lack a part of it.
        """
        return Provenance.from_json(self.metadata["marl_mm"])

    @cached_property
    def episodes(self) -> list[Episode]:
        """Episodes, in order; their arrays are views."""
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
        """Hash of the transitions, 16 hex digits: states, actions, rewards, episodes.

        An episode's last state, and why it ended, are not in it, as records of
        version 1 hold this hash; they are in ``data_sha256`` of the metadata.
        """
        joint, digest = self._joint, hashlib.sha256()
        for array in (joint.observation, joint.action, joint.reward, joint.episode):
            digest.update(array.tobytes())
        return digest.hexdigest()[:16]

    def identity(self) -> dict[str, str]:
        """Id, path and fingerprint, for the config of a run."""
        return {
            "id": self.metadata["dataset_id"],
            "path": str(self.location.folder),
            "fingerprint": self.fingerprint,
        }

    def joint(self) -> Transitions:
        """Transitions with joint states, shape (n, d), and actions, shape (n, k)."""
        return self._joint

    def agents(self) -> dict[str, Transitions]:
        """Transitions with each agent's observation and action, by agent, in order."""
        return {
            agent.name: self._joint.part(agent.observation, agent.action)
            for agent in self.arrays.layout.agents
        }


def load_dataset(name: str | Path | Location) -> Dataset:
    """Read a dataset by id or path.

    Args:
        name: Id such as ``marl_mm/reach/pd-v0``, or a path, or a location. A plain word
            such as ``pd`` is short for ``marl_mm/reach/pd-v0``, always of ``reach``,
            but for the name of a named dataset, such as ``gate-noisy``. Where there is
            none, it may be a folder's name. A ``Path`` is never an id.

    Raises:
        UnknownDatasetError: If no dataset has this name; the message names similar
            ones.
        DatasetError: If the files are damaged.
    """
    if not isinstance(name, str | Path | Location):
        raise UsageError(f"{name!r:.80} is no dataset's name, expected an id or a path")
    location = name if isinstance(name, Location) else existing(text_of(name))
    metadata = read_metadata(location)
    return Dataset(location, metadata, read_arrays(location, metadata))


def existing(text: str) -> Location:
    """Location of a dataset to read; one that ships is unpacked at its first use."""
    location = find(text)
    unpack(location)
    return location


def unpack(location: Location) -> None:
    """Write the dataset that belongs at a location, if it ships and is missing."""
    ships = location.id in shipped.IDS and location == locate(location.id)
    if ships and not location.folder.exists():
        shipped.install(location)
