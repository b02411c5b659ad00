"""Export to robomimic, OGBench and d3rlpy, each of which reads one file."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.export import (
    DATASET_FORMS,
    DatasetForm,
    Tables,
    description,
    episode_steps,
)
from marl_mm.datasets.hdf5_files import write_tables
from marl_mm.datasets.storage import env_spec

_GYM = 2
"""robomimic's ``EnvType.GYM_TYPE``."""


def _robomimic(dataset: Dataset, path: Path) -> None:
    """Write ``data/demo_i``, with the joint state and each agent's part of it.

    ``dones`` are the terminal steps alone: robomimic's critics ask for no value there.
    """
    joint, views = dataset.joint(), {"state": dataset.joint(), **dataset.agents()}
    about = description(dataset, "robomimic")
    spec = env_spec(dataset.provenance)
    kwargs = {} if spec is None else spec.kwargs
    name = f"marl_mm:marl_mm/{about['task']}"
    env = {"env_name": name, "type": _GYM, "env_kwargs": kwargs}
    groups = {"data": {"total": len(joint), "env_args": json.dumps(env)}}
    tables: Tables = {}
    for number, steps in enumerate(episode_steps(dataset)):
        demo = f"data/demo_{number}"
        for name, view in views.items():
            tables[f"{demo}/obs/{name}"] = view.observation[steps]
            tables[f"{demo}/next_obs/{name}"] = view.next_observation[steps]
        tables[f"{demo}/actions"] = joint.action[steps]
        tables[f"{demo}/rewards"] = joint.reward[steps]
        tables[f"{demo}/dones"] = joint.terminated[steps].astype(np.int64)
        groups[demo] = {"num_samples": steps.stop - steps.start}
    write_tables(path, tables, about, groups)


def _ogbench(dataset: Dataset, path: Path) -> None:
    """Write all states of all episodes; the row of a last state has no action.

    ``terminals`` mark these rows, whatever ended the episode; ``masks`` are 0 at
    terminal steps, as in OGBench's data of a single task.
    """
    arrays = dataset.arrays
    last = arrays.is_last_state()
    tables: Tables = {"observations": arrays.states, "terminals": last}
    steps = (arrays.actions, arrays.rewards, ~arrays.terminated)
    for key, values in zip(("actions", "rewards", "masks"), steps, strict=True):
        tables[key] = np.zeros((len(last), *values.shape[1:]))
        tables[key][~last] = values
    contents: dict[str, Any] = {
        **{key: values.astype(np.float32) for key, values in tables.items()},
        "marl_mm": json.dumps(description(dataset, "ogbench")),
    }
    with path.open("wb") as file:  # numpy would add its ending to a name
        np.savez_compressed(file, **contents)


def _d3rlpy(dataset: Dataset, path: Path) -> None:
    """Write what ``ReplayBuffer.dump`` writes, in version 2.1 of its format."""
    joint, steps = dataset.joint(), episode_steps(dataset)
    columns = {
        "observations": joint.observation.astype(np.float32),
        "actions": joint.action,
        "rewards": joint.reward.astype(np.float32)[:, None],
    }
    tables: Tables = {
        "columns": np.array([*columns, "terminated"], "S"),
        "num_episodes": np.array(len(steps)),
        "version": np.array("2.1", "S"),
    }
    for number, part in enumerate(steps):
        for key, values in columns.items():
            tables[f"{key}_{number}"] = values[part]
        tables[f"terminated_{number}"] = joint.terminated[part.stop - 1]
    write_tables(path, tables, description(dataset, "d3rlpy"))


DATASET_FORMS.add(
    "robomimic",
    DatasetForm(
        about="robomimic's HDF5: data/demo_i; obs are state and each agent's.",
        write=_robomimic,
    ),
)
DATASET_FORMS.add(
    "ogbench",
    DatasetForm(
        about="OGBench's npz: all states in float32, also rewards and masks.",
        write=_ogbench,
    ),
)
DATASET_FORMS.add(
    "d3rlpy",
    DatasetForm(about="d3rlpy's ReplayBuffer, in float32.", write=_d3rlpy),
)
