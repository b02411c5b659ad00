"""Import of files of others, whose forms stand in ``import_forms``."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.datasets.hdf5 import FILE, ROBOT_NUMBERS
from marl_mm.datasets.hdf5_files import open_hdf5, reading_limits
from marl_mm.datasets.import_forms import IMPORTS
from marl_mm.datasets.metadata import METADATA_BYTES
from marl_mm.datasets.plausible import problems_of
from marl_mm.envs.registry import DEFAULT, TASKS, make_task
from marl_mm.envs.task import Task
from marl_mm.errors import DatasetError, UsageError, WorkerDiedError
from marl_mm.layout import Layout
from marl_mm.layout_diff import refuse_other_layout
from marl_mm.received import (
    check_regular,
    parse_json,
    read_json,
    refuse_links_out,
)
from marl_mm.sim.config import engine_of
from marl_mm.version1 import dataset_layout
from marl_mm.workers import apart


@dataclass(frozen=True)
class Foreign:
    """Contents of a file that others wrote."""

    arrays: EpisodeArrays
    """Arrays of all episodes."""

    task: str
    """Registered name of the task whose rewards these are."""

    engine: str | None
    """Engine that the file names, whether there is one of the name here or not; None
    where it names none."""


def read_foreign(path: Path, dataset_id: str, task: str | None = None) -> Foreign:
    """The episodes of a file that others wrote.

    Args:
        path: HDF5 file, or folder of a Minari dataset.
        dataset_id: Id of the dataset that is made of it.
        task: Registered name of the task whose rewards these are; default the file's
            own, or Reach-v0 if it names none.

    Raises:
        UsageError: If there is no such file or task, or the file's layout is not the
            task's.
        DatasetError: If the file cannot be read, or holds impossible values. The
            message names the key, what was got and what was expected.
    """
    if task is not None:
        TASKS.get(task)
    for name in (f"data/{FILE}", FILE):
        if (path / name).exists():
            refuse_links_out(path, (name, "data/metadata.json"), DatasetError)
            path = path / name
    if path.is_dir() or not path.exists():
        what = "is a folder without" if path.is_dir() else "does not exist, nor"
        raise UsageError(
            f"{path} {what} {FILE}: expected an HDF5 file or a Minari dataset's folder"
        )
    size = check_regular(path, DatasetError)
    if not h5py.is_hdf5(path):
        raise DatasetError(f"{path} is no HDF5 file, or a damaged one ({size} bytes)")
    limits = reading_limits(size)
    try:
        name = task or apart(_task_of, path, *limits) or DEFAULT
        arrays, engine = apart(_read, (path, dataset_id, name), *limits)
    except UsageError as error:
        way_out = "" if task else ", or give `task`"
        raise UsageError(f"{path}: {error}{way_out}") from error
    except WorkerDiedError as error:
        raise DatasetError(
            f"{path} is damaged: the HDF5 library cannot read it ({error})"
        ) from error
    if problems := problems_of(arrays):
        raise DatasetError(f"{path}: {'; '.join(problems)}")
    return Foreign(arrays, name, engine)


def _task_of(path: Path) -> str | None:
    """Name of the task in a file; reading a damaged file can crash or never end."""
    with open_hdf5(path) as file:
        return _text(_metadata(path, file), "task")


def _read(arguments: tuple[Path, str, str]) -> tuple[EpisodeArrays, str | None]:
    """Episodes and engine of a file; arguments: path, the dataset's id, the task."""
    path, dataset_id, name = arguments
    task = make_task(name)
    with open_hdf5(path) as file:
        forms = [form for _, form in reversed(IMPORTS.items()) if form.fits(file)]
        metadata = _metadata(path, file)
        layout = _layout(metadata)
        if layout is not None:
            agents = forms[0].by_agent
            refuse_other_layout("its data", layout, name, task.layout, agents)
        episodes = forms[0].episodes(path, file, task.layout, list(task.info))
    start = np.full(ROBOT_NUMBERS * task.robots, np.nan)  # nobody knows it
    arrays = arrays_of([replace(one, start=start) for one in episodes], dataset_id)
    return _judged(arrays, task, path), _engine(metadata)


def _judged(arrays: EpisodeArrays, task: Task, path: Path) -> EpisodeArrays:
    """Episodes with their success, where the file does not say it.

    An episode that ended has reached its goal, unless its task can fail too: then the
    task's own rule decides, from the state after the step.
    """
    told = np.asarray(arrays.info["is_success"], np.float64)
    if not (np.isin(told, (0, 1)) | np.isnan(told)).all():
        raise DatasetError(
            f"{path}: 'infos/is_success' holds other values than 0, 1 and NaN"
        )
    if not np.isnan(told).any():
        return arrays
    hit = arrays.terminated
    if task.fails:
        after = arrays.states[~arrays.is_first_state()]
        achieved, goal = after[:, arrays.layout.achieved], after[:, arrays.layout.goal]
        terms = arrays.reward_terms(task.needs)
        hit = hit & task.reached(achieved, goal, terms)
    success = np.where(np.isnan(told), hit, told == 1)
    return replace(arrays, info={**arrays.info, "is_success": success})


def _engine(metadata: Mapping[str, Any]) -> str | None:
    """Engine in a file's attributes, or in our metadata beside it."""
    overrides = metadata.get("overrides")
    if isinstance(overrides, Mapping):
        metadata = {"engine": engine_of(overrides)}
    return _text(metadata, "engine")


def _text(metadata: Mapping[str, Any], name: str) -> str | None:
    """A text of the metadata, which a file may hold as bytes; None without one."""
    text = metadata.get(name)
    if isinstance(text, bytes):
        text = text.decode(errors="replace")
    if not isinstance(text, str | None):
        raise DatasetError(f"its {name} is {text!r:.60}, expected a text")
    return text


def _metadata(path: Path, file: Any) -> Mapping[str, Any]:
    """Attributes of a file, or our metadata beside it."""
    if "task" in file.attrs:
        return dict(file.attrs)
    beside = path.parent / "metadata.json"
    metadata = None
    if beside.exists():
        metadata = read_json(beside, DatasetError, METADATA_BYTES)
    record = metadata.get("marl_mm") if isinstance(metadata, dict) else None
    return record if isinstance(record, dict) else {}


def _layout(metadata: Mapping[str, Any]) -> Layout | None:
    """The layout in the metadata, or the one of version 1 with the same entries."""
    layout = metadata.get("layout")
    if layout is None:
        return dataset_layout(metadata) if "state" in metadata else None
    if isinstance(layout, str):
        layout = parse_json(layout, "the layout in the file", DatasetError)
    return Layout.from_json(layout)
