"""Minari's HDF5 format, ``episode_i/...``; the only file that reads and writes it.

Arrays are written in HDF5's compact layout, which Minari reads like its own. It needs a
fifth of the space: most episodes are so short that the records about chunks would
outweigh the numbers.
"""

import errno
import os
import re
import resource
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.episode import Episode
from marl_mm.errors import DatasetError, MarlMmError
from marl_mm.files import named_errors
from marl_mm.layout import Layout

FILE = "main_data.hdf5"

_DAMAGE = (
    *(OSError, KeyError, ValueError, RuntimeError, TypeError, MemoryError),
    OverflowError,
)
"""Exceptions that h5py raises for damaged files."""

_START = "initial_configuration"


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
        Field("observations/achieved_goal", "float", goal, 1),
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
    compact = _without_times()
    compact.set_layout(h5py.h5d.COMPACT)

    def fill(file: Any) -> None:
        for number in range(len(arrays)):
            group = file.create_group(f"episode_{number}")
            group.attrs.update(_attributes(arrays, number))
            for key, values in _contents(arrays.episode(number)).items():
                folder, _, name = key.rpartition("/")
                parent = group.require_group(folder) if folder else group
                _write(parent, name, values, compact)

    _write_new(path, fill, libver=("v110", "v110"))


def _write(group: Any, name: str, values: np.ndarray, compact: Any) -> None:
    values = np.ascontiguousarray(values)
    large = values.nbytes >= 60_000  # the layout ends at 64 KiB
    kind = h5py.h5t.py_create(values.dtype, logical=True)
    space = h5py.h5s.create_simple(values.shape)
    dataset = h5py.h5d.create(
        group.id, name.encode(), kind, space, _without_times() if large else compact
    )
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, values)


def _without_times() -> Any:
    """Properties of an array that keep the time of writing out of the file."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)
    return properties


def _contents(episode: Episode) -> dict[str, np.ndarray]:
    layout = episode.layout
    return {
        "observations/observation": episode.states[:, layout.observation],
        "observations/achieved_goal": episode.states[:, layout.achieved],
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


def write_tables(
    path: Path, tables: dict[str, np.ndarray], attributes: dict[str, Any]
) -> None:
    """Write flat arrays by key, compressed, and attributes of the file.

    Raises:
        OSError: If there is no room for the file; it names the file.
    """

    def fill(file: Any) -> None:
        for key, values in tables.items():
            file.create_dataset(key, data=values, compression="gzip", shuffle=True)
        file.attrs.update(attributes)

    _write_new(path, fill)


def _write_new(path: Path, fill: Callable[[Any], None], **options: Any) -> None:
    """Write a new HDF5 file, which a function fills, by way of memory.

    On a full disk, HDF5 itself complains on stderr and may end the process. Its own
    files in memory have other bytes than those on a disk, so it writes one of the
    operating system's; the driver "stdio" does not mind that it has no path.

    Raises:
        OSError: If there is no room for the file; it names the file.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    if limit != resource.RLIM_INFINITY and _size(fill, options) > limit:
        # It holds in memory, too.
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    with os.fdopen(os.memfd_create(FILE), "r+b") as memory:
        name = f"/proc/self/fd/{memory.fileno()}"
        with h5py.File(name, "w", driver="stdio", **options) as file:
            fill(file)
        with named_errors(path), path.open("wb") as disk:
            shutil.copyfileobj(memory, disk)


def _size(fill: Callable[[Any], None], options: Mapping[str, Any]) -> int:
    """Size of a file before HDF5 cuts what it kept in reserve [bytes]."""
    nowhere = {"driver": "core", "backing_store": False}
    with h5py.File(FILE, "w", **nowhere, **options) as file:
        fill(file)
        file.flush()
        return len(file.id.get_file_image())


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    """Open an HDF5 file for reading.

    Raises:
        DatasetError: If the file is damaged, or a part that the block reads.
    """
    try:
        with h5py.File(path, "r") as file:
            yield file
    except MarlMmError:
        raise
    except _DAMAGE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DatasetError(f"{path} is damaged ({reason:.160})") from error


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
    with open_hdf5(path) as file:
        for number in range(total):
            group = file[f"episode_{number}"]
            values = checked(path, group, wanted)
            attributes = dict(group.attrs)
            start = np.asarray(attributes[_START])
            episodes.append(
                Episode(
                    states=states_of(values, layout),
                    actions=values["actions"],
                    rewards=values["rewards"],
                    terminated=values["terminations"],
                    truncated=values["truncations"],
                    info={key: values[f"infos/{key}"] for key in info},
                    seed=int(attributes["seed"]),
                    index=int(attributes["index"]),
                    source=str(attributes["collector"]),
                    start=start,
                    layout=layout,
                )
            )
            origins.append(str(attributes["source_dataset"]))
            numbers.append(int(attributes["source_episode"]))
    arrays = arrays_of(episodes, "")
    return arrays.named(np.array(origins), np.array(numbers))


def achieved_goals(path: Path, total: int) -> np.ndarray:
    """Achieved goals as the file has them, shape (n + E, g)."""
    with open_hdf5(path) as file:
        names = (f"episode_{i}/observations/achieved_goal" for i in range(total))
        return np.concatenate([file[name][()] for name in names])


def states_of(values: dict[str, np.ndarray], layout: Layout) -> np.ndarray:
    """Joint states of an episode's observations, shape (T + 1, d)."""
    goal = values["observations/desired_goal"]
    return layout.state_of(values["observations/observation"], goal)


def episode_groups(file: Any) -> list[Any]:
    """Groups of Minari's episodes in a file, in order; empty for other formats."""
    names = [name for name in file if re.fullmatch(r"episode_\d+", name)]
    return [file[name] for name in sorted(names, key=lambda name: int(name[8:]))]


def optional(group: Any, key: str) -> np.ndarray | None:
    """The array of numbers of this key; None if there is none."""
    node = group.get(key)
    if not isinstance(node, h5py.Dataset) or node.dtype.kind not in _KINDS["number"]:
        return None
    return np.asarray(node[()])


def _has(group: Any, key: str) -> bool:
    return isinstance(group.get(key), h5py.Dataset)


def checked(path: Path, group: Any, wanted: tuple[Field, ...]) -> dict[str, np.ndarray]:
    """Arrays of a group by key, all as long as ``rewards``.

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
            missing = [repr(item.key) for item in wanted if not _has(group, item.key)]
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
        value = np.empty(shape, kind)
        node.read(h5py.h5s.ALL, h5py.h5s.ALL, value)
        if field.kind == "float" and not np.isfinite(value).all():
            raise DatasetError(f"{where}: {field.key!r} holds a NaN or an infinity")
        values[field.key] = value
    return values
