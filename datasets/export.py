"""Datasets in the flat layouts that other libraries read: one HDF5 file each."""

import json
from pathlib import Path
from typing import Literal

import numpy as np

from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.hdf5 import write_tables
from marl_mm.errors import UsageError
from marl_mm.files import new_file, refuse_existing

Form = Literal["agents", "flat", "d4rl"]


def export(dataset: Dataset, form: Form, path: Path, overwrite: bool) -> None:
    """Write all steps, one after the other.

    ``flat``: observations (n, d), actions (n, k), next_observations, rewards,
    terminals, timeouts, and each step's episode; types as they are stored. ``d4rl``:
    the same with float32, and ``infos/goal``. ``agents``: observations, actions and
    next_observations in one group per agent, the joint ones as ``state`` and
    ``next_state``, and what both share.

    Raises:
        OutputExistsError: If the file exists and may not be replaced.
        UsageError: If it is a folder.
    """
    if path.is_dir():
        raise UsageError(f"{path} is a folder, expected a file to write")
    refuse_existing(path, overwrite)
    tables = {"flat": _flat, "d4rl": _d4rl, "agents": _agents}[form](dataset)
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
