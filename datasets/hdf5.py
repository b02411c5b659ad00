"""Minari's HDF5 format, ``episode_i/...``; the only module that reads and writes it.

Arrays are written in HDF5's compact layout, which Minari reads like its own. It needs a
fifth of the space: most episodes are so short that the records about chunks would
outweigh the numbers.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.datasets.hdf5_files import (
    LONGEST_TEXT,
    compact,
    open_hdf5,
    write_array,
    write_new,
)
from marl_mm.episode import Episode
from marl_mm.errors import DatasetError
from marl_mm.layout import Layout
from marl_mm.received import check_regular, is_printable

FILE = "main_data.hdf5"

_START = "initial_configuration"

ACHIEVED = "observations/achieved_goal"
"""Key of the entries that are compared with the goal."""

ROBOT_NUMBERS = 11
"""Numbers of a robot's configuration: base's place, cosine, sine, seven joints."""

_LEAST_EPISODE = 200
"""Least size of an episode in a file [bytes]; ours have 4,000."""


@dataclass(frozen=True)
class Field:
    """Key, type and shape of an array that an episode must have."""

    key: str
    """Key of the array within the episode's group."""

    kind: str
    """Accepted kind of type: "float", "bool" or "number"."""

    columns: int | None = None
    """Number of columns; None for one-dimensional arrays."""

    extra: int = 0
    """Number of rows beyond the episode's steps."""


_KINDS = {"float": "f", "bool": "b", "number": "fiub"}


def episode_fields(layout: Layout) -> tuple[Field, ...]:
    """Arrays that every episode with goal-dictionary observations has."""
    goal = len(layout.desired)
    return (
        Field("observations/observation", "float", len(layout.state) - goal, 1),
        Field(ACHIEVED, "float", goal, 1),
        Field("observations/desired_goal", "float", goal, 1),
        Field("actions", "float", len(layout.action)),
        Field("rewards", "float"),
        Field("terminations", "bool"),
        Field("truncations", "bool"),
    )


def write_hdf5(path: Path, arrays: EpisodeArrays) -> None:
    """Write all episodes into a new file.

    Raises:
        OSError: If there is no room for the file; it names the file.
    """
    within = compact()

    def fill(file: Any) -> None:
        for number in range(len(arrays)):
            group = file.create_group(f"episode_{number}")
            group.attrs.update(_attributes(arrays, number))
            for key, values in _contents(arrays.episode(number)).items():
                folder, _, name = key.rpartition("/")
                parent = group.require_group(folder) if folder else group
                write_array(parent, name, values, within)

    write_new(path, fill, libver=("v110", "v110"))


def _contents(episode: Episode) -> dict[str, np.ndarray]:
    layout = episode.layout
    return {
        "observations/observation": episode.states[:, layout.observation],
        ACHIEVED: episode.states[:, layout.achieved],
        "observations/desired_goal": episode.states[:, layout.goal],
        "actions": episode.actions,
        "rewards": episode.rewards,
        "terminations": episode.terminated,
        "truncations": episode.truncated,
        **{f"infos/{key}": values for key, values in episode.info.items()},
    }


def _attributes(arrays: EpisodeArrays, number: int) -> dict[str, Any]:
    """Metadata of an episode; those down to ``rewards_max`` are Minari's."""
    episode = arrays.episode(number)
    rewards = episode.rewards
    return {
        "id": number,
        "seed": episode.seed,
        "total_steps": len(episode),
        "rewards_sum": float(rewards.sum()),
        "rewards_mean": float(rewards.mean()),
        "rewards_std": float(rewards.std()),
        "rewards_min": float(rewards.min()),
        "rewards_max": float(rewards.max()),
        "index": episode.index,
        "collector": episode.source,
        **({} if episode.direction is None else {"direction": episode.direction}),
        "is_success": episode.success,
        "source_dataset": str(arrays.origins[number]),
        "source_episode": int(arrays.origin_episodes[number]),
        _START: episode.start,
    }


def read_hdf5(
    path: Path, total: int, layout: Layout, info: Sequence[str]
) -> EpisodeArrays:
    """All episodes of a file that ``write_hdf5`` wrote.

    Args:
        path: The file.
        total: Number of episodes in the file.
        layout: Layout of the states and actions.
        info: Names of the step numbers.

    Raises:
        DatasetError: If the file is damaged, naming episode, key and expectation.
    """
    episodes, origins, numbers = [], [], []
    wanted = *episode_fields(layout), *(Field(f"infos/{key}", "number") for key in info)
    refuse_count(path, total)
    with open_hdf5(path) as file:
        if (count := sum(map(_is_episode, file))) != total:
            raise DatasetError(
                f"{path} has {count:,} episodes, expected {total:,} as in metadata.json"
            )
        for number in range(total):
            group = opened_group(path, file, f"episode_{number}")
            values = checked(path, group, wanted)
            attributes = _Attributes(path, group)
            states = states_of(values, layout)
            if (states[:, layout.achieved] != values[ACHIEVED]).any():
                raise DatasetError(
                    f"{path}, episode_{number}: 'achieved_goal' is not what the "
                    f"observations say of {', '.join(layout.compared)}"
                )
            episodes.append(
                Episode(
                    states=states,
                    actions=values["actions"],
                    rewards=values["rewards"],
                    terminated=values["terminations"],
                    truncated=values["truncations"],
                    info={key: values[f"infos/{key}"] for key in info},
                    seed=attributes.number("seed"),
                    index=attributes.number("index"),
                    source=attributes.text("collector"),
                    start=attributes.start(),
                    layout=layout,
                )
            )
            origins.append(attributes.text("source_dataset"))
            numbers.append(attributes.number("source_episode"))
            if episodes[-1].start.shape != episodes[0].start.shape:
                raise DatasetError(
                    f"{path}, episode_{number}: {_START!r} has "
                    f"{len(episodes[-1].start)} numbers, expected "
                    f"{len(episodes[0].start)} as in the first"
                )
    arrays = arrays_of(episodes, "")
    return arrays.named(np.array(origins), np.array(numbers))


class _Attributes:
    """Attributes of an episode's group, each of the type that it must have.

    Raises:
        DatasetError: From each method, if the attribute is missing or of another type.
    """

    def __init__(self, path: Path, group: Any) -> None:
        self._path, self._group = path, group

    def number(self, name: str) -> int:
        """An integer of at most 64 bits."""
        value = self._group.attrs.get(name)
        fits = isinstance(value, int | np.integer) and -(2**63) <= int(value) < 2**63
        if not fits:
            shown = value.item() if isinstance(value, np.integer) else value
            raise self._refused(name, shown, "an integer of 64 bits with its sign")
        return int(value)

    def text(self, name: str) -> str:
        """A line of text."""
        value = self._group.attrs.get(name)
        if (
            not isinstance(value, str)
            or len(value) > LONGEST_TEXT
            or not is_printable(value)
        ):
            raise self._refused(name, value, "a line of text")
        return value

    def start(self) -> np.ndarray:
        """The robots' configurations, shape (11 R,)."""
        value = np.asarray(self._group.attrs.get(_START))
        if value.dtype.kind != "f" or value.ndim != 1 or value.size % ROBOT_NUMBERS:
            expected = f"{ROBOT_NUMBERS} numbers for each robot"
            raise self._refused(_START, value, expected)
        return value

    def _refused(self, name: str, value: Any, expected: str) -> DatasetError:
        where = f"{self._path}, {self._group.name.removeprefix('/')}"
        return DatasetError(f"{where}: {name!r} is {value!a:.60}, expected {expected}")


def states_of(values: dict[str, np.ndarray], layout: Layout) -> np.ndarray:
    """Joint states of an episode's observations, shape (T + 1, d)."""
    goal = values["observations/desired_goal"]
    return layout.state_of(values["observations/observation"], goal)


def is_of_episodes(file: Any) -> bool:
    """Whether an open file has Minari's episodes."""
    return any(map(_is_episode, file))


def _is_episode(name: str) -> bool:
    return re.fullmatch(r"episode_\d+", name) is not None


def episode_groups(path: Path, file: Any) -> Iterator[Any]:
    """Groups of Minari's episodes in an open file, in order.

    Raises:
        DatasetError: If there are more than the file can hold, or one is no group.
    """
    names = [*filter(_is_episode, file)]
    refuse_count(path, len(names))
    for name in sorted(names, key=lambda name: int(name[8:])):
        yield opened_group(path, file, name)


def refuse_count(path: Path, total: int) -> None:
    """Raise for more episodes than a file can hold.

    Raises:
        DatasetError: If it would be too small for so many.
    """
    size = check_regular(path, DatasetError)
    if total > size / _LEAST_EPISODE:
        raise DatasetError(f"{path} has {size:,} bytes, too few for {total:,} episodes")


def opened_group(path: Path, parent: Any, name: str) -> Any:
    """A group within another.

    Raises:
        DatasetError: If it is missing.
    """
    group = parent.get(name)
    if not isinstance(group, h5py.Group):
        raise DatasetError(f"{path} has no group {name!r}")
    return group


def optional(group: Any, key: str) -> np.ndarray | None:
    """The array of numbers of this key; None if there is none."""
    node = group.get(key)
    if not isinstance(node, h5py.Dataset) or node.dtype.kind not in "fiub":
        return None
    return _values(node.id)


def _values(node: Any) -> np.ndarray:
    """An array's values."""
    value = np.empty(node.shape, node.dtype)
    node.read(h5py.h5s.ALL, h5py.h5s.ALL, value)
    return value


def checked(path: Path, group: Any, wanted: tuple[Field, ...]) -> dict[str, np.ndarray]:
    """Arrays of a group by key: a row per entry of ``rewards``, and ``extra`` more.

    Args:
        path: The file, for messages.
        group: Group to read.
        wanted: Arrays that it must have.

    Raises:
        DatasetError: If an array is missing, of another type or shape, or not finite.
    """
    where = f"{path}, {group.name.removeprefix('/')}".rstrip(", ")
    ordered = sorted(wanted, key=lambda field: field.key != "rewards")
    values: dict[str, np.ndarray] = {}
    steps = 0
    for field in ordered:
        try:
            node = h5py.h5d.open(group.id, field.key.encode())  # the fast way
        except KeyError:
            keys = [item.key for item in wanted]
            missing = [repr(key) for key in keys if key not in group]
            missing = missing or [f"{field.key!r}, but a group"]
            raise DatasetError(f"{where} has no array {', '.join(missing)}") from None
        shape, kind = node.shape, node.dtype
        if kind.kind not in _KINDS[field.kind]:
            raise DatasetError(
                f"{where}: {field.key!r} has type {kind}, expected {field.kind}"
            )
        if field.key == "rewards":
            steps = shape[0] if len(shape) == 1 else 0
        row = () if field.columns is None else (field.columns,)
        expected = (steps + field.extra, *row)
        if shape != expected or not steps:
            wanted_shape = expected if steps else "(steps,)"
            raise DatasetError(
                f"{where}: {field.key!r} has shape {shape}, expected {wanted_shape}"
            )
        value = _values(node)
        if field.kind == "float" and not np.isfinite(value).all():
            raise DatasetError(f"{where}: {field.key!r} holds a NaN or an infinity")
        values[field.key] = value
    return values
