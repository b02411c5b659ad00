"""The folder of a dataset: Minari's ``data/``, our metadata in it, and a cache.

The stored form is joint: goal-dictionary observations, joint actions, team rewards. Our
own metadata are under the key ``marl_mm``, with a hash of the data and one of
themselves. ``cache/`` holds the same episodes as flat arrays, named after the data's
hash. It is written with the dataset, and again if it is missing.
"""

import difflib
import hashlib
import json
import re
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from minari.dataset.minari_storage import MinariStorage

from marl_mm.datasets.arrays import EpisodeArrays, load_arrays, save_arrays
from marl_mm.datasets.hdf5 import FILE, read_hdf5, write_hdf5
from marl_mm.datasets.journal import FILE as JOURNAL
from marl_mm.datasets.location import SHIPPED, Location, datasets_root, known_ids
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.reference import reference_scores
from marl_mm.envs.registry import TASKS
from marl_mm.episode import INFO
from marl_mm.errors import (
    DatasetError,
    LayoutError,
    UnknownDatasetError,
    UsageError,
)
from marl_mm.files import (
    new_file,
    new_folder,
    only_here,
    refuse_existing,
    write_json,
)
from marl_mm.layout import Layout
from marl_mm.spaces import action_space, goal_observation_space
from marl_mm.version1 import dataset_layout
from marl_mm.versions import versions

SCHEMA = 3
"""Version of our metadata; version 2 had no layout, and is read, too."""

OWN_FILES = frozenset(
    {
        "data",
        f"data/{FILE}",
        "data/metadata.json",
        "cache",
        "card.json",
        "card.md",
        "card.png",
    }
)
"""Files and folders that a dataset's folder may hold, beside arrays in the cache."""


def write_dataset(
    location: Location,
    arrays: EpisodeArrays,
    provenance: Provenance,
    overwrite: bool = False,
) -> None:
    """Write a dataset; it appears whole or not at all.

    Args:
        location: Id and folder of the dataset.
        arrays: Arrays of the episodes.
        provenance: Provenance of the episodes.
        overwrite: Whether an existing dataset may be replaced.

    Raises:
        OutputExistsError: If the dataset exists and may not be replaced.
        UsageError: If the folder holds other files.
    """
    refuse_existing(location.folder, overwrite)
    refuse_foreign(location)
    if location.name == location.id:
        _name_namespaces(location)
    with new_folder(location.folder) as temporary:
        storage = MinariStorage.new(
            temporary / "data",
            observation_space=goal_observation_space(arrays.layout),
            action_space=action_space(arrays.layout),
            env_spec=env_spec(provenance),
            data_format="hdf5",
        )
        path = temporary / "data" / FILE
        path.unlink()
        write_hdf5(path, arrays)
        digest = file_digest(path)
        storage.update_metadata(
            {
                "total_episodes": len(arrays),
                "total_steps": arrays.steps,
                "dataset_size": storage.get_size(),
                **_metadata(location, arrays, provenance, digest),
            }
        )
        sign_metadata(temporary / "data" / "metadata.json")
        _write_cache(temporary, digest, arrays)


def write_alone(
    location: Location,
    arrays: EpisodeArrays,
    provenance: Provenance,
    overwrite: bool = False,
) -> None:
    """Write a dataset, as ``write_dataset`` does, unless a collection is in progress.

    Raises:
        UsageError: If another process is writing it, or a collection was begun there.
    """
    with only_here(location.working):
        if any(location.working.iterdir()):
            raise UsageError(
                f"a collection was begun at {location.folder}: finish it with "
                "`marl_mm.collect(..., resume=True)`, or delete it"
            )
        try:
            write_dataset(location, arrays, provenance, overwrite)
        finally:
            location.working.rmdir()


def env_spec(provenance: Provenance) -> EnvSpec | None:
    """Gymnasium's specification of a dataset's environment; None for unknown tasks.

    It includes the number of steps, which d3rlpy reads there.
    """
    if provenance.task not in TASKS:
        return None
    spec = deepcopy(gymnasium.spec(f"marl_mm/{provenance.task}"))
    spec.kwargs["overrides"] = dict(provenance.overrides)
    spec.max_episode_steps = provenance.overrides.get("max_steps")
    return spec


def refuse_foreign(location: Location) -> None:
    """Raise before a folder with other files than a dataset's would be replaced.

    Raises:
        UsageError: If the folder holds other files.
    """
    folder = location.folder
    if not folder.exists():
        return
    inner = [path.relative_to(folder) for path in folder.rglob("*")]
    ours = all(map(_is_ours, inner))
    if not folder.is_dir() or not ours:
        raise UsageError(
            f"{folder} is no dataset, or holds other files too: it is left alone"
        )


def _is_ours(path: Path) -> bool:
    """Whether a dataset's folder may hold this path, also after a writer was killed."""
    return (
        str(path) in OWN_FILES
        or (path.parts[0] == "cache" and path.suffix == ".npz")
        or re.fullmatch(r"\.card\.\d+\.(json|md|png)", str(path)) is not None
    )


def read_metadata(location: Location) -> dict[str, Any]:
    """A dataset's metadata.

    Raises:
        UnknownDatasetError: If there is no such dataset; the message names similar
            ones.
        DatasetError: If the metadata are damaged, or of another format.
    """
    if not location.folder.exists():
        raise UnknownDatasetError(_why_unknown(location))
    if not location.data.is_dir():
        kind = "a folder" if location.folder.is_dir() else "a file"
        raise UnknownDatasetError(
            f"{location.folder} is {kind} and no dataset of marl_mm; marl-mm datasets "
            "import takes HDF5 files of others"
        )
    path = location.data / "metadata.json"
    try:
        metadata: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DatasetError(f"cannot read {path}: {reason}") from error
    ours = metadata.get("marl_mm") if isinstance(metadata, dict) else None
    schema = ours.get("schema") if isinstance(ours, dict) else None
    if not isinstance(ours, dict) or schema not in (2, SCHEMA):
        raise DatasetError(
            f"{path} is of no marl_mm dataset of schema 2 or {SCHEMA}: its schema is "
            f"{schema!r}; marl-mm datasets import takes other HDF5 files"
        )
    if ours.get("metadata_sha256") != _metadata_digest(metadata):
        raise DatasetError(
            f"{path} is damaged: it is not as it was written; marl-mm datasets import "
            "takes files that were changed on purpose"
        )
    return metadata


def layout_in(metadata: dict[str, Any]) -> Layout:
    """The layout of a dataset's states and actions.

    Raises:
        DatasetError: If the metadata have no layout, or one that makes no sense.
    """
    ours = metadata["marl_mm"]
    try:
        if ours["schema"] == SCHEMA:
            return Layout.from_json(ours.get("layout", {}))
        return dataset_layout(ours)
    except LayoutError as error:
        raise DatasetError(f"metadata.json: {error}") from error


def _why_unknown(location: Location) -> str:
    name = location.name
    if (location.working / JOURNAL).exists():
        return (
            f"the collection into {name} was begun and not finished: go on with "
            "`marl_mm.collect(..., resume=True)`"
        )
    ids = {known: Path(known).name for known in (SHIPPED, *known_ids())}
    close = difflib.get_close_matches(location.folder.name, set(ids.values()), 3, 0.7)
    similar = [known for known, last in ids.items() if last in close]
    hint = f"did you mean {' or '.join(similar)}?" if similar else "make it first;"
    where = f" below {datasets_root()}" if name == location.id else ""
    return f"no dataset {name}{where}: {hint} marl-mm datasets list shows all"


def read_arrays(
    location: Location, metadata: dict[str, Any], cached: bool = True
) -> EpisodeArrays:
    """All episodes of a dataset, in order.

    Args:
        location: Id and folder of the dataset.
        metadata: Result of ``read_metadata``.
        cached: Whether to read the cache first, and write it if it is missing.

    Raises:
        DatasetError: If the data are not as they were written.
    """
    path = location.data / FILE
    expected = metadata["marl_mm"]["data_sha256"]
    try:
        digest = file_digest(path)
    except OSError as error:
        raise DatasetError(f"cannot read {path}: {error.strerror}") from error
    if digest != expected:
        raise DatasetError(
            f"{path} is damaged: its {path.stat().st_size} bytes are not those that "
            f"were written; marl-mm datasets delete {location.name} removes it, and "
            "what made it makes it again"
        )
    layout, ours = layout_in(metadata), metadata["marl_mm"]
    if cached and (found := _read_cache(location.folder, digest, layout)) is not None:
        return found
    arrays = read_hdf5(path, ours["episodes"], layout, ours.get("info", list(INFO)))
    if cached:
        try:
            _write_cache(location.folder, digest, arrays)
        except OSError:  # somebody else's folder, or a full disk: it works without
            pass
    return arrays


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def cache_file(folder: Path, digest: str) -> Path:
    """Path of the flat arrays of data with this hash."""
    return folder / "cache" / f"{digest[:16]}.npz"


def _read_cache(folder: Path, digest: str, layout: Layout) -> EpisodeArrays | None:
    path = cache_file(folder, digest)
    try:
        return load_arrays(path, layout) if path.exists() else None
    except DatasetError:  # it is only a cache
        return None


def _write_cache(folder: Path, digest: str, arrays: EpisodeArrays) -> None:
    path = cache_file(folder, digest)
    for old in path.parent.glob("*.npz"):
        old.unlink()
    with new_file(path) as temporary:
        save_arrays(temporary, arrays, compress=False)


def _metadata(
    location: Location,
    arrays: EpisodeArrays,
    provenance: Provenance,
    digest: str,
) -> dict[str, Any]:
    sources = ", ".join(np.unique(arrays.sources).tolist())
    ours = {
        "schema": SCHEMA,
        "layout": arrays.layout.to_json(),
        "info": list(arrays.info),
        "packages": versions(),
        "statistics": statistics(arrays),
        "episodes": len(arrays),
        "steps": arrays.steps,
        "data_sha256": digest,
        **provenance.to_json(location.id),
    }
    return {
        "dataset_id": location.id,
        "algorithm_name": sources,
        "author": {"marl_mm"},
        "description": f"Episodes of {sources} on marl_mm.",
        "minari_version": versions()["minari"],
        **reference_scores(provenance.task),
        "marl_mm": ours,
    }


def sign_metadata(path: Path) -> None:
    """Store the metadata's checksum inside the metadata."""
    metadata = json.loads(path.read_text())
    metadata["marl_mm"]["metadata_sha256"] = _metadata_digest(metadata)
    path.write_text(json.dumps(metadata))


def _metadata_digest(metadata: dict[str, Any]) -> str:
    ours = metadata["marl_mm"].items()
    rest = {key: value for key, value in ours if key != "metadata_sha256"}
    text = json.dumps({**metadata, "marl_mm": rest}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def statistics(arrays: EpisodeArrays) -> dict[str, Any]:
    """Mean and standard deviation of every entry of states and actions."""
    states = arrays.states[~arrays.is_last_state()]
    actions = arrays.actions.astype(float)
    return {
        "state_mean": states.mean(axis=0).tolist(),
        "state_std": states.std(axis=0).tolist(),
        "action_mean": actions.mean(axis=0).tolist(),
        "action_std": actions.std(axis=0).tolist(),
    }


def _name_namespaces(location: Location) -> None:
    """Write the metadata of the namespace, without which Minari does not list it."""
    folder = Path(location.id).parent
    path = datasets_root() / folder / "namespace_metadata.json"
    if not path.exists():
        write_json(path, {"description": "Datasets made by marl_mm."})
