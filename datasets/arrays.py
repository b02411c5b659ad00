"""Many episodes as one set of arrays, from which files, caches and views are made."""

import struct
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from os import SEEK_END
from pathlib import Path
from typing import IO

import numpy as np

from marl_mm.episode import Episode, directions, failures, reward_terms
from marl_mm.errors import DatasetError
from marl_mm.layout import Layout
from marl_mm.layout_diff import layout_diff
from marl_mm.received import most_unpacked


@dataclass(frozen=True, eq=False)
class EpisodeArrays:
    """Arrays of E episodes with n steps in all, one after the other."""

    states: np.ndarray
    """Joint states, including the last one of each episode, shape (n + E, d)."""

    actions: np.ndarray
    """Joint actions, shape (n, k), float32."""

    rewards: np.ndarray
    """Rewards of the steps, shape (n,)."""

    terminated: np.ndarray
    """Whether a step reached the goal or failed, shape (n,), bool."""

    truncated: np.ndarray
    """Whether the episode ran out of steps, shape (n,), bool."""

    info: dict[str, np.ndarray]
    """Step numbers by name, shape (n,) each; see ``Task.info``."""

    lengths: np.ndarray
    """Number of steps of each episode, shape (E,)."""

    seeds: np.ndarray
    """Seed of each episode, shape (E,), int64."""

    indices: np.ndarray
    """Number of each episode's attempt in its collection, shape (E,)."""

    starts: np.ndarray
    """Configurations of the robots at each start, shape (E, 11 R); see ``Episode``."""

    sources: np.ndarray
    """Name of the policy that acted in each episode, shape (E,), text."""

    origins: np.ndarray
    """Id of the dataset that each episode was collected for, shape (E,), text."""

    origin_episodes: np.ndarray
    """Number of each episode in that dataset, shape (E,)."""

    layout: Layout
    """Layout of states and actions."""

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def steps(self) -> int:
        """Number of steps, n."""
        return len(self.rewards)

    @property
    def nbytes(self) -> int:
        """Size of all arrays in memory [bytes]."""
        arrays = (*self.info.values(), *(getattr(self, name) for name in _ARRAYS))
        return sum(array.nbytes for array in arrays)

    @cached_property
    def _ends(self) -> np.ndarray:
        return np.cumsum(self.lengths)

    def episode(self, number: int) -> Episode:
        """The episode of a number, whose arrays are views."""
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
            layout=self.layout,
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
        """Number of each step's episode, shape (n,)."""
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
        """Whether a step ended its episode without success, shape (n,), bool."""
        return failures(self.terminated, self.info["is_success"])

    def first_states(self) -> np.ndarray:
        """First joint state of each episode, shape (E, d)."""
        return np.asarray(self.states[self.is_first_state()])

    def ahead(self) -> np.ndarray | None:
        """Whether each episode's goal is ahead, shape (E,); see ``directions``."""
        return directions(self.first_states(), self.layout)

    def reward_terms(self, needs: Iterable[str]) -> dict[str, np.ndarray]:
        """Numbers that rewards depend on beside the goal; see ``Task.needs``."""
        after = self.states[~self.is_first_state()]
        return reward_terms(needs, self.info, self.failed(), after, self.layout)

    def named(self, origins: np.ndarray, numbers: np.ndarray) -> "EpisodeArrays":
        """The same episodes with other origins, ids of datasets, and numbers there."""
        return replace(self, origins=origins, origin_episodes=numbers)

    def select(self, numbers: Sequence[int] | np.ndarray) -> "EpisodeArrays":
        """Copies of the episodes of these numbers, in this order."""
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
            layout=self.layout,
        )


_DAMAGE = (
    *(OSError, ValueError, KeyError, EOFError, RuntimeError, OverflowError),
    *(MemoryError, zipfile.BadZipFile, zlib.error, struct.error, TypeError),
)
"""Exceptions that reading a damaged npz file raises."""

_PER_EPISODE = ("seeds", "indices", "starts", "sources", "origins", "origin_episodes")

_ARRAYS = tuple(
    field.name
    for field in fields(EpisodeArrays)
    if field.name not in ("info", "layout")
)
"""Fields of ``EpisodeArrays`` that are arrays."""


def arrays_of(episodes: Iterable[Episode], origin: str) -> EpisodeArrays:
    """Arrays of episodes that were collected for a dataset, in its order.

    Args:
        episodes: Episodes, at least one.
        origin: Id of the dataset.

    Raises:
        DatasetError: If there are no episodes, or their layouts or infos differ.
    """
    listed = list(episodes)
    if not listed:
        raise DatasetError(f"no episode for {origin}")
    layout, info = listed[0].layout, list(listed[0].info)
    for episode in listed:
        _refuse_unlike(layout, info, episode.layout, episode.info)
    return EpisodeArrays(
        states=np.concatenate([e.states for e in listed]),
        actions=np.concatenate([e.actions for e in listed]),
        rewards=np.concatenate([e.rewards for e in listed]),
        terminated=np.concatenate([e.terminated for e in listed]),
        truncated=np.concatenate([e.truncated for e in listed]),
        info={key: np.concatenate([e.info[key] for e in listed]) for key in info},
        lengths=np.array([len(e) for e in listed]),
        seeds=np.array([e.seed for e in listed]),
        indices=np.array([e.index for e in listed]),
        starts=np.stack([e.start for e in listed]),
        sources=np.array([e.source for e in listed]),
        origins=np.array([origin] * len(listed)),
        origin_episodes=np.arange(len(listed)),
        layout=layout,
    )


def joined(parts: Sequence[EpisodeArrays]) -> EpisodeArrays:
    """The episodes of several sets of arrays, one after the other.

    Raises:
        DatasetError: If their layouts, infos or robots differ.
    """
    layout, keys = parts[0].layout, list(parts[0].info)
    for part in parts:
        _refuse_unlike(layout, keys, part.layout, part.info)
        if part.starts.shape[1:] != parts[0].starts.shape[1:]:
            raise DatasetError(
                "the starts of some episodes are of other robots: import these anew"
            )
    info = {key: np.concatenate([part.info[key] for part in parts]) for key in keys}
    return EpisodeArrays(
        info=info,
        layout=layout,
        **{name: np.concatenate([getattr(p, name) for p in parts]) for name in _ARRAYS},
    )


def _refuse_unlike(
    layout: Layout, keys: Sequence[str], other: Layout, info: Mapping[str, np.ndarray]
) -> None:
    if other != layout:
        raise DatasetError(
            "episodes of two layouts cannot be one dataset: "
            f"{'; '.join(layout_diff(layout, other))}"
        )
    if set(keys) != info.keys():
        differ = sorted(set(keys) ^ info.keys())
        raise DatasetError(f"only some of the episodes have {', '.join(differ)}")


def save_arrays(file: Path | IO[bytes], arrays: EpisodeArrays, compress: bool) -> None:
    """Write arrays as one npz file, without their layout."""
    values = {f"info/{key}": value for key, value in arrays.info.items()}
    values |= {name: getattr(arrays, name) for name in _ARRAYS}
    (np.savez_compressed if compress else np.savez)(file, allow_pickle=False, **values)


def load_arrays(
    file: Path | IO[bytes], layout: Layout, packed: bool = True
) -> EpisodeArrays:
    """Read what ``save_arrays`` wrote.

    Args:
        file: The npz file.
        layout: Layout of the states and actions.
        packed: Whether the file may be compressed.

    Raises:
        DatasetError: If the file is damaged, or of another layout.
    """
    try:
        _refuse_bomb(file, packed)
        with np.load(file, allow_pickle=False) as values:
            keys = [key for key in values if key.startswith("info/")]
            if unknown := {*values} - {*keys} - {*_ARRAYS}:
                raise ValueError(f"unknown arrays {', '.join(sorted(unknown))}")
            info = {key.removeprefix("info/"): values[key] for key in keys}
            arrays = {name: values[name] for name in _ARRAYS}
    except _DAMAGE as error:
        raise DatasetError(f"{file} is damaged ({error})") from error
    loaded = EpisodeArrays(info=info, layout=layout, **arrays)
    if problem := _inconsistency(loaded):
        raise DatasetError(f"{file} is damaged ({problem})")
    return loaded


def _refuse_bomb(file: Path | IO[bytes], packed: bool) -> None:
    """Raise for a file that asks for far more memory than its size can hold."""
    with zipfile.ZipFile(file) as parts:
        size = sum(part.file_size for part in parts.infolist())
    whole = file.stat().st_size if isinstance(file, Path) else file.seek(0, SEEK_END)
    if not isinstance(file, Path):
        file.seek(0)
    if size > (most_unpacked(whole) if packed else whole):
        raise ValueError(f"{size:,} bytes of arrays in a file of {whole:,} bytes")


def _inconsistency(arrays: EpisodeArrays) -> str:
    """Why arrays cannot be those of whole episodes; empty if they can."""
    lengths, layout = arrays.lengths, arrays.layout
    if lengths.ndim != 1 or lengths.dtype.kind != "i" or not len(lengths):
        return f"lengths of shape {lengths.shape} and type {lengths.dtype}"
    if lengths.min() < 1 or lengths.max() > len(arrays.rewards):
        return f"an episode of {lengths.min()} or {lengths.max()} steps"
    steps, episodes = int(lengths.sum()), len(lengths)
    expected: dict[str, tuple[str, tuple[int, ...]]] = {
        "states": ("f", (steps + episodes, len(layout.state))),
        "actions": ("f", (steps, len(layout.action))),
        "rewards": ("f", (steps,)),
        "terminated": ("b", (steps,)),
        "truncated": ("b", (steps,)),
        "starts": ("f", (episodes, *arrays.starts.shape[1:][:1])),
        "seeds": ("iu", (episodes,)),
        "indices": ("iu", (episodes,)),
        "origin_episodes": ("iu", (episodes,)),
        "sources": ("U", (episodes,)),
        "origins": ("U", (episodes,)),
    }
    values = {name: getattr(arrays, name) for name in expected}
    for key, value in arrays.info.items():
        expected[f"info/{key}"], values[f"info/{key}"] = ("fiub", (steps,)), value
    for name, (kinds, shape) in expected.items():
        array = values[name]
        if array.dtype.kind not in kinds or array.shape != shape:
            return (
                f"{name} of shape {array.shape} and type {array.dtype}, expected "
                f"{shape} for {episodes} episodes"
            )
    return ""


def _ranges(begins: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """begin, ..., begin + length - 1 of every pair, one after the other."""
    offsets = np.cumsum(lengths) - lengths
    shifts: np.ndarray = np.repeat(begins - offsets, lengths)
    return np.asarray(np.arange(len(shifts)) + shifts)
