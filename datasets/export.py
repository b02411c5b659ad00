"""Export of datasets to files that other libraries read: a registry of their forms."""

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.hdf5_files import write_tables
from marl_mm.errors import UsageError
from marl_mm.files import new_file, new_folder, refuse_existing, refuse_foreign
from marl_mm.registry import Registry
from marl_mm.sim.config import engine_of
from marl_mm.versions import refuse_missing

Tables = dict[str, np.ndarray]
"""Arrays by key."""


@dataclass(frozen=True, kw_only=True)
class DatasetForm:
    """A form of export: what another library reads."""

    about: str
    """Sentence that describes the file or folder."""

    write: Callable[[Dataset, Path], None]
    """Function that writes a dataset into a new file, or an empty folder."""

    mark: tuple[str, str] | None = None
    """Name of a file in the folder that it writes, and a text in that; None for forms
    of one file."""

    holds: tuple[str, ...] = ()
    """Patterns of the paths of all files in that folder; empty for any."""

    packages: tuple[str, ...] = ()
    """Modules that it needs, of the optional extra of its name."""


DATASET_FORMS: Registry[DatasetForm] = Registry(
    "form",
    modules=(
        "marl_mm.datasets.export",
        "marl_mm.datasets.export_files",
        "marl_mm.datasets.export_lerobot",
        "marl_mm.datasets.export_vault",
        "marl_mm.datasets.export_hub",
    ),
    of=DatasetForm,
)
"""All forms of export by name."""


def export(
    dataset: Dataset | str | Path, form: str, path: str | Path, overwrite: bool = False
) -> None:
    """Write a dataset in a form that another library reads.

    Args:
        dataset: The dataset, its id or its path.
        form: Name of one of ``DATASET_FORMS``.
        path: File or folder to write, as the form is.
        overwrite: Whether it may be replaced if it exists; a folder only if it is an
            earlier one of the form.

    Raises:
        OutputExistsError: If it exists and may not be replaced.
        UsageError: If there is no such form, a package that it needs is missing, or the
            path is a folder where a file is written, or the other way around, or lies
            within the dataset.
    """
    if not isinstance(dataset, Dataset):
        dataset = load_dataset(dataset)
    if not isinstance(path, str | Path):
        raise UsageError(f"`path` is {path!r:.80}, expected a file or folder")
    refuse_existing(Path(path), overwrite=True)
    chosen, path = DATASET_FORMS.get(form), Path(path).absolute()
    real = Path(os.path.realpath(path))  # which goes round no circle of links
    if real.is_relative_to(dataset.location.folder.resolve()):
        raise UsageError(f"{path} lies within the dataset: choose another name")
    if path.exists() and path.is_dir() != (chosen.mark is not None):
        is_, expected = ("folder", "file") if path.is_dir() else ("file", "folder")
        raise UsageError(f"{path} is a {is_}, expected a {expected} to write")
    if chosen.mark is None:
        refuse_existing(path, overwrite)
    else:
        refuse_foreign(path, overwrite, chosen.mark, chosen.holds)
    refuse_missing(form, chosen.packages)
    with (new_file if chosen.mark is None else new_folder)(path) as temporary:
        chosen.write(dataset, temporary)
        refuse_existing(path, overwrite)  # another process may have been faster


def description(dataset: Dataset, form: str) -> dict[str, Any]:
    """Id, task, engine, layout, names of entries and agents, as JSON values."""
    layout = dataset.arrays.layout
    return {
        "dataset_id": dataset.metadata["dataset_id"],
        "task": dataset.provenance.task,
        "engine": engine_of(dataset.provenance.overrides),
        "engine_version": dataset.provenance.engine_text.partition(" ")[2],
        "form": form,
        "layout": json.dumps(layout.to_json()),
        "state": list(layout.state_names),
        "action": list(layout.action_names),
        "agents": list(dataset.agents()),
    }


def episode_steps(dataset: Dataset) -> list[slice]:
    """Places of each episode's steps among all steps."""
    ends = np.cumsum(dataset.arrays.lengths).tolist()
    return [slice(*ends_) for ends_ in zip([0, *ends[:-1]], ends, strict=True)]


def _add(name: str, about: str, tables: Callable[[Dataset], Tables]) -> None:
    """Register a form of flat arrays in one HDF5 file."""

    def write(dataset: Dataset, path: Path) -> None:
        write_tables(path, tables(dataset), description(dataset, name))

    DATASET_FORMS.add(name, DatasetForm(about=about, write=write))


def _shared(dataset: Dataset) -> Tables:
    joint = dataset.joint()
    return {
        "rewards": joint.reward,
        "terminals": joint.terminated,
        "timeouts": joint.truncated,
        "episodes": joint.episode,
        "infos/is_success": dataset.arrays.info["is_success"],
    }


def _flat(dataset: Dataset) -> Tables:
    joint = dataset.joint()
    return {
        "observations": joint.observation,
        "actions": joint.action,
        "next_observations": joint.next_observation,
        **_shared(dataset),
    }


def _d4rl(dataset: Dataset) -> Tables:
    flat = _flat(dataset)
    floats = ("observations", "next_observations", "rewards")
    flat |= {name: flat[name].astype(np.float32) for name in floats}
    return flat | {"infos/goal": flat["observations"][:, dataset.arrays.layout.goal]}


def _agents(dataset: Dataset) -> Tables:
    joint = dataset.joint()
    tables = {"state": joint.observation, "next_state": joint.next_observation}
    for name, view in dataset.agents().items():
        tables[f"{name}/observations"] = view.observation
        tables[f"{name}/actions"] = view.action
        tables[f"{name}/next_observations"] = view.next_observation
    return tables | _shared(dataset)


_add(
    "flat",
    "Joint observations (n, d), actions (n, k), next_observations, rewards, terminals, "
    "timeouts, episodes, infos/is_success; types as stored.",
    _flat,
)
_add("d4rl", "The same in float32, and infos/goal.", _d4rl)
_add("agents", "One group per agent; joint arrays as state and next_state.", _agents)
