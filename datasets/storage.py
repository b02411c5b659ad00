"""The folder of a dataset: Minari's ``data/``, our metadata in it, and a cache.

The stored form is joint: goal-dictionary observations, joint actions, team rewards.
``cache/`` holds the same episodes as flat arrays, named after the data's hash. It is
written with the dataset, and again if it is missing.
"""

import hashlib
import re
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec
from minari.dataset.minari_storage import MinariStorage

from marl_mm.datasets.arrays import EpisodeArrays, load_arrays, save_arrays
from marl_mm.datasets.hdf5 import FILE, read_hdf5, write_hdf5
from marl_mm.datasets.location import Location, datasets_root
from marl_mm.datasets.metadata import layout_in, new_metadata, sign_metadata
from marl_mm.datasets.provenance import Provenance
from marl_mm.envs.registry import TASKS
from marl_mm.episode import INFO
from marl_mm.errors import DatasetError, UsageError
from marl_mm.files import (
    new_file,
    new_folder,
    only_here,
    refuse_existing,
    write_json,
)
from marl_mm.layout import Layout
from marl_mm.spaces import action_space, goal_observation_space

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
                **new_metadata(location, arrays, provenance, digest),
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
            f"were written; delete it with marl-mm datasets delete {location.name} and "
            "make it again"
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


def _name_namespaces(location: Location) -> None:
    """Write the metadata of the namespace, without which Minari does not list it."""
    folder = Path(location.id).parent
    path = datasets_root() / folder / "namespace_metadata.json"
    if not path.exists():
        write_json(path, {"description": "Datasets made by marl_mm."})
