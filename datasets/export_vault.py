"""Export to a Vault of flashbax, with the arrays that OG-MARL reads.

A Vault is a folder: ``metadata.json``, and one database of tensorstore with an array of
shape (1, time, ...) for each leaf.
"""

import errno
import json
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.datasets.dataset import Dataset, Transitions
from marl_mm.datasets.export import DATASET_FORMS, DatasetForm, Tables, description

_VERSION = 1.2
"""Version of the format; readers refuse another whole number."""

_LONGEST = 10**13
"""Length of the time axis that flashbax gives every array, filled or not."""

_MARK = "metadata.json"


def _vault(dataset: Dataset, path: Path) -> None:
    """Write a Vault whose agents are stacked along the axis after time.

    Agents of fewer entries are filled with zeros at the end, as in OG-MARL's
    multi-agent MuJoCo; ``metadata.json`` has each agent's number of entries.
    """
    joint, agents = dataset.joint(), dataset.agents()
    shared = {
        "rewards": joint.reward,
        "terminals": joint.terminated,
        "truncations": joint.truncated,
    }
    leaves: Tables = {
        "observations": _stacked([view.observation for view in agents.values()]),
        "actions": _stacked([view.action for view in agents.values()]),
        **{key: _stacked([values] * len(agents)) for key, values in shared.items()},
        "infos.state": joint.observation.astype(np.float32)[None],
    }
    about = {
        "version": _VERSION,
        "structure_shape": _tree({key: str(x.shape) for key, x in leaves.items()}),
        "structure_dtype": _tree({key: str(x.dtype) for key, x in leaves.items()}),
        "sizes": {name: _sizes(view) for name, view in agents.items()},
    }
    about |= description(dataset, "flashbax")
    (path / _MARK).write_text(json.dumps(about, indent=2) + "\n", "utf-8")
    for key, values in leaves.items():
        _write(path, f"{key}.", values, [1, _LONGEST, *values.shape[2:]])
    _write(path, "vault_index", np.array([len(joint)], np.int32), [1])


def _write(path: Path, name: str, values: np.ndarray, shape: list[int]) -> None:
    """Write values as the beginning of an array of a larger shape."""
    import tensorstore

    spec = {
        "driver": "zarr",
        "kvstore": {
            "driver": "ocdbt",
            "base": {"driver": "file", "path": f"{path}/"},
            "path": name,
        },
        "metadata": {
            "compressor": {"id": "gzip", "level": 5},
            "chunks": [min(size, 65_536) for size in values.shape],
        },
    }
    options: dict[str, Any] = {"shape": shape, "dtype": values.dtype, "create": True}
    try:
        store = tensorstore.open(spec, **options).result()
        store[tuple(map(slice, values.shape))].write(values).result()
    except ValueError as error:  # of a full disk, too
        reason = str(error).rpartition(": ")[2]
        raise OSError(errno.EIO, reason, str(path)) from error


def _stacked(agents: list[np.ndarray]) -> np.ndarray:
    """Values of all agents, shape (1, n, agents, ...), float32, filled with zeros."""
    most = max(values.shape[1:] for values in agents)
    stacked = np.zeros((1, len(agents[0]), len(agents), *most), np.float32)
    for number, values in enumerate(agents):
        part = (..., slice(values.shape[1])) if most else (...,)
        stacked[0, :, number][part] = values
    return stacked


def _sizes(view: Transitions) -> dict[str, int]:
    return {
        "observations": view.observation.shape[1],
        "actions": view.action.shape[1],
    }


def _tree(values: dict[str, str]) -> dict[str, object]:
    """Values by key, those whose keys have a dot in a branch."""
    infos = {"state": values.pop("infos.state")}
    return {**values, "infos": infos}


DATASET_FORMS.add(
    "flashbax",
    DatasetForm(
        about="Vault of flashbax as in OG-MARL: agents stacked, filled with zeros.",
        write=_vault,
        mark=(_MARK, '"form": "flashbax"'),
        holds=("d/*", "*.ocdbt*", _MARK),
        packages=("tensorstore",),
    ),
)
