"""Export of datasets as flat arrays in one HDF5 file, which other libraries read."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.hdf5 import write_tables
from marl_mm.errors import UsageError
from marl_mm.files import new_file, refuse_existing
from marl_mm.registry import Registry


@dataclass(frozen=True, kw_only=True)
class DatasetForm:
    """A form of export: the flat arrays of a dataset."""

    about: str
    """Sentence that describes the arrays."""

    tables: Callable[[Dataset], dict[str, np.ndarray]]
    """Function of a dataset that returns the arrays by key."""


DATASET_FORMS: Registry[DatasetForm] = Registry("form", of=DatasetForm)
"""All forms of export by name."""


def export(dataset: Dataset, form: str, path: Path, overwrite: bool) -> None:
    """Write all steps of a dataset, one after the other, into an HDF5 file.

    Args:
        dataset: The dataset.
        form: Name of one of ``DATASET_FORMS``.
        path: File to write.
        overwrite: Whether an existing file may be replaced.

    Raises:
        OutputExistsError: If the file exists and may not be replaced.
        UsageError: If the path is a folder.
    """
    if path.is_dir():
        raise UsageError(f"{path} is a folder, expected a file to write")
    refuse_existing(path, overwrite)
    tables = DATASET_FORMS.get(form).tables(dataset)
    layout = dataset.arrays.layout
    attributes = {
        "dataset_id": dataset.metadata["dataset_id"],
        "task": dataset.provenance.task,
        "form": form,
        "layout": json.dumps(layout.to_json()),
        "state": list(layout.state_names),
        "action": list(layout.action_names),
        "agents": list(dataset.agents()),
    }
    with new_file(path) as temporary:
        write_tables(temporary, tables, attributes)


def _shared(dataset: Dataset) -> dict[str, np.ndarray]:
    joint = dataset.joint()
    return {
        "rewards": joint.reward,
        "terminals": joint.terminated,
        "timeouts": joint.truncated,
        "episodes": joint.episode,
    }


def _flat(dataset: Dataset) -> dict[str, np.ndarray]:
    joint = dataset.joint()
    return {
        "observations": joint.observation,
        "actions": joint.action,
        "next_observations": joint.next_observation,
        **_shared(dataset),
    }


def _d4rl(dataset: Dataset) -> dict[str, np.ndarray]:
    flat = _flat(dataset)
    floats = ("observations", "next_observations", "rewards")
    flat |= {name: flat[name].astype(np.float32) for name in floats}
    return flat | {"infos/goal": flat["observations"][:, dataset.arrays.layout.goal]}


def _agents(dataset: Dataset) -> dict[str, np.ndarray]:
    joint = dataset.joint()
    tables = {"state": joint.observation, "next_state": joint.next_observation}
    for name, view in dataset.agents().items():
        tables[f"{name}/observations"] = view.observation
        tables[f"{name}/actions"] = view.action
        tables[f"{name}/next_observations"] = view.next_observation
    return tables | _shared(dataset)


DATASET_FORMS.add(
    "flat",
    DatasetForm(
        about="Joint observations (n, d), actions (n, k), next_observations, rewards, "
        "terminals, timeouts, episodes; types as stored.",
        tables=_flat,
    ),
)
DATASET_FORMS.add(
    "d4rl", DatasetForm(about="The same in float32, and infos/goal.", tables=_d4rl)
)
DATASET_FORMS.add(
    "agents",
    DatasetForm(
        about="One group per agent; joint arrays as state and next_state.",
        tables=_agents,
    ),
)
