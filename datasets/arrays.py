"""Many episodes as one set of arrays: what files, caches and views are made of."""

import struct
import zipfile
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import IO

import numpy as np

from marl_mm.episode import INFO, Episode, failures
from marl_mm.errors import DatasetError
from marl_mm.layout import Layout, layout_of


@dataclass(frozen=True)
class EpisodeArrays:
    """E episodes of n steps in all, one after the other."""

    states: np.ndarray
    """Joint states, each episode's last one included, shape (n + E, d)."""

    actions: np.ndarray
    """Shape (n, k), float32."""

    rewards: np.ndarray
    """Shape (n,)."""

    terminated: np.ndarray
    """Shape (n,), bool."""

    truncated: np.ndarray
    """Shape (n,), bool."""

    info: dict[str, np.ndarray]
    """One array of shape (n,) for each name in ``marl_mm.episode.INFO``."""

    lengths: np.ndarray
    """Steps of each episode, shape (E,)."""

    seeds: np.ndarray
    """Shape (E,), int64."""

    indices: np.ndarray
    """Number of the attempt in its collection, shape (E,)."""

    starts: np.ndarray
    """Configuration of the robot at each start, shape (E, 11)."""

    sources: np.ndarray
    """Name of the policy that acted, shape (E,), text."""

    origins: np.ndarray
    """Id of the dataset that each episode was collected for, shape (E,), text."""

    origin_episodes: np.ndarray
    """Its number there, shape (E,)."""

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def steps(self) -> int:
        """N."""
        return len(self.rewards)

    @property
    def layout(self) -> Layout:
        """Of states and actions."""
        return layout_of(self.states.shape[1])

    @cached_property
    def _ends(self) -> np.ndarray:
        return np.cumsum(self.lengths)

    def episode(self, number: int) -> Episode:
        """One episode, whose arrays are views of these."""
        end, length = int(self._ends[number]), int(self.lengths[number])
        steps = slice(end - length, end)
        return Episode(
            states=self.states[end - length + number : end + number + 1],
            actions=self.actions[steps],
            rewards=self.rewards[steps],
            terminated=self.terminated[steps],
            truncated=self.truncated[steps],
            info={key: values[steps] for key, values in self.info.items()},
            seed=int(self.seeds[number]),
            index=int(self.indices[number]),
            source=str(self.sources[number]),
            start=self.starts[number],
        )

    def is_last_state(self) -> np.ndarray:
        """Whether no action follows a state, shape (n + E,)."""
        last = np.zeros(len(self.states), bool)
        last[self._ends + np.arange(len(self))] = True
        return last

    def is_first_state(self) -> np.ndarray:
        """Whether a state begins an episode, shape (n + E,)."""
        return np.roll(self.is_last_state(), 1)

    def step_episode(self) -> np.ndarray:
        """The number of each step's episode, shape (n,)."""
        return np.repeat(np.arange(len(self)), self.lengths)

    def returns(self) -> np.ndarray:
        """Undiscounted sum of each episode's rewards, shape (E,)."""
        begins = self._ends - self.lengths
        return np.asarray(np.add.reduceat(self.rewards, begins))

    def successes(self) -> np.ndarray:
        """Whether each episode reached its goal, shape (E,)."""
        last = self._ends - 1
        return np.asarray(self.terminated[last] & ~self.failed()[last])

    def failed(self) -> np.ndarray:
        """Steps that ended their episode without success, shape (n,), bool."""
        return failures(self.terminated, self.info["is_success"])

    def first_states(self) -> np.ndarray:
        """Shape (E, 10)."""
        return np.asarray(self.states[self.is_first_state()])

    def named(self, origins: np.ndarray, numbers: np.ndarray) -> "EpisodeArrays":
        """The same episodes, said to come from these episodes of these datasets."""
        return replace(self, origins=origins, origin_episodes=numbers)

    def select(self, numbers: Sequence[int] | np.ndarray) -> "EpisodeArrays":
        """These episodes, in this order, as copies."""
        chosen = np.asarray(numbers, dtype=np.int64)
        lengths = self.lengths[chosen]
        begins = self._ends[chosen] - lengths
        steps = _ranges(begins, lengths)
        states = _ranges(begins + chosen, lengths + 1)
        return EpisodeArrays(
            states=self.states[states],
            actions=self.actions[steps],
            rewards=self.rewards[steps],
            terminated=self.terminated[steps],
            truncated=self.truncated[steps],
            info={key: values[steps] for key, values in self.info.items()},
            lengths=lengths,
            **{name: getattr(self, name)[chosen] for name in _PER_EPISODE},
        )


_DAMAGE = (
    *(OSError, ValueError, KeyError, EOFError, RuntimeError, OverflowError),
    *(MemoryError, zipfile.BadZipFile, zlib.error, struct.error, TypeError),
)
"""What reading a damaged npz file raises."""

_PER_EPISODE = ("seeds", "indices", "starts", "sources", "origins", "origin_episodes")


def arrays_of(episodes: Iterable[Episode], origin: str) -> EpisodeArrays:
    """Episodes that were collected for a dataset, in the order of that dataset.

    Args:
        episodes: At least one.
        origin: The dataset's id.

    Raises:
        DatasetError: If there are no episodes.
    """
    listed = list(episodes)
    if not listed:
        raise DatasetError(f"no episode for {origin}")
    return EpisodeArrays(
        states=np.concatenate([one.states for one in listed]),
        actions=np.concatenate([one.actions for one in listed]),
        rewards=np.concatenate([one.rewards for one in listed]),
        terminated=np.concatenate([one.terminated for one in listed]),
        truncated=np.concatenate([one.truncated for one in listed]),
        info={key: np.concatenate([one.info[key] for one in listed]) for key in INFO},
        lengths=np.array([len(one) for one in listed]),
        seeds=np.array([one.seed for one in listed]),
        indices=np.array([one.index for one in listed]),
        starts=np.stack([one.start for one in listed]),
        sources=np.array([one.source for one in listed]),
        origins=np.array([origin] * len(listed)),
        origin_episodes=np.arange(len(listed)),
    )


def joined(parts: Sequence[EpisodeArrays]) -> EpisodeArrays:
    """The episodes of several, one after the other."""
    info = {key: np.concatenate([part.info[key] for part in parts]) for key in INFO}
    names = [field.name for field in fields(EpisodeArrays) if field.name != "info"]
    return EpisodeArrays(
        info=info,
        **{name: np.concatenate([getattr(p, name) for p in parts]) for name in names},
    )


def save_arrays(file: Path | IO[bytes], arrays: EpisodeArrays, compress: bool) -> None:
    """Write arrays as one npz file."""
    values = {f"info/{key}": value for key, value in arrays.info.items()}
    for field in fields(arrays):
        if field.name != "info":
            values[field.name] = getattr(arrays, field.name)
    (np.savez_compressed if compress else np.savez)(file, allow_pickle=False, **values)


def load_arrays(file: Path | IO[bytes]) -> EpisodeArrays:
    """Read what ``save_arrays`` wrote.

    Raises:
        DatasetError: If it is damaged.
    """
    try:
        with np.load(file, allow_pickle=False) as values:
            names = [one.name for one in fields(EpisodeArrays) if one.name != "info"]
            info = {key: values[f"info/{key}"] for key in INFO}
            return EpisodeArrays(info=info, **{name: values[name] for name in names})
    except _DAMAGE as error:
        raise DatasetError(f"{file} is damaged ({error})") from error


def _ranges(begins: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """begin, ..., begin + length - 1 of every pair, one after the other."""
    offsets = np.cumsum(lengths) - lengths
    shifts: np.ndarray = np.repeat(begins - offsets, lengths)
    return np.asarray(np.arange(len(shifts)) + shifts)
