"""The folder of a dataset: Minari's ``data/``, our metadata in it, and the card.

The stored form is joint: goal-dictionary observations, joint actions, team rewards.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec
from minari.dataset.minari_storage import MinariStorage

from marl_mm.datasets import cache
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.datasets.convert import read_apart
from marl_mm.datasets.hdf5 import FILE, write_hdf5
from marl_mm.datasets.location import Location, datasets_root
from marl_mm.datasets.metadata import (
    OWN_FILES,
    layout_in,
    new_metadata,
    read_metadata,
    sign_metadata,
)
from marl_mm.datasets.plausible import problems_of, problems_of_record
from marl_mm.datasets.provenance import Provenance
from marl_mm.envs.registry import TASKS
from marl_mm.episode import INFO
from marl_mm.errors import DatasetError, UsageError
from marl_mm.files import new_folder, only_here, refuse_existing, write_json
from marl_mm.received import file_digest
from marl_mm.sim.config import as_recorded
from marl_mm.spaces import action_space, goal_observation_space


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
        UsageError: If the folder holds other files, or ``$MARL_MM_CACHE_GB`` is no
            number.
        DatasetError: If the arrays contradict their layout or one another.
    """
    cache.most_bytes()  # raises before anything is written
    _refuse_problems(problems_of(arrays), location.folder)
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
        digest = file_digest(path, DatasetError)
        storage.update_metadata(
            {
                "total_episodes": len(arrays),
                "total_steps": arrays.steps,
                "dataset_size": storage.get_size(),
                **new_metadata(location, arrays, provenance, digest),
            }
        )
        sign_metadata(temporary / "data" / "metadata.json")
        read_metadata(Location(location.id, temporary))  # before it replaces anything
    cache.keep(_key(digest, arrays), arrays)


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
    with alone(location):
        write_dataset(location, arrays, provenance, overwrite)


@contextmanager
def alone(location: Location) -> Iterator[None]:
    """Keep other processes from writing a dataset meanwhile; see ``write_alone``."""
    with only_here(location.working):
        if any(location.working.iterdir()):
            raise UsageError(
                f"a collection was begun at {location.folder}: finish it with "
                "`marl_mm.collect(..., resume=True)`, or delete it"
            )
        try:
            yield
        finally:
            location.working.rmdir()


def env_spec(provenance: Provenance) -> EnvSpec | None:
    """Gymnasium's specification of a dataset's environment; None for unknown tasks.

    It includes the number of steps, which d3rlpy reads there.
    """
    if provenance.task not in TASKS:
        return None
    spec = deepcopy(gymnasium.spec(f"marl_mm/{provenance.task}"))
    spec.kwargs["overrides"] = as_recorded(provenance.overrides)
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
    inner = (path.relative_to(folder) for path in folder.rglob("*"))
    if not folder.is_dir() or not all(map(_is_part, inner)):
        raise UsageError(
            f"{folder} is no dataset, or holds other files too: it is left alone"
        )


_CARD_IN_WORK = r"\.card\.(\d+|[0-9a-f]{16}\.part)\.(json|md|png)"
"""Temporary file of a card, of older versions too."""


def _is_part(path: Path) -> bool:
    """Whether a dataset's folder may hold this path, also after a writer was killed."""
    return (
        str(path) in OWN_FILES
        or (path.parts[0] == "cache" and path.suffix == ".npz")
        or re.fullmatch(_CARD_IN_WORK, str(path)) is not None
    )


def read_arrays(
    location: Location, metadata: dict[str, Any], cached: bool = True
) -> EpisodeArrays:
    """All episodes of a dataset, in order.

    Args:
        location: Id and folder of the dataset.
        metadata: Result of ``read_metadata``.
        cached: Whether to look into the user's cache first.

    Raises:
        DatasetError: If the data are not as they were written.
    """
    path, record = location.data / FILE, metadata["marl_mm"]
    about = location.data / "metadata.json"
    _refuse_problems(problems_of_record(metadata, None), about)
    digest = file_digest(path, DatasetError)
    if digest != record["data_sha256"]:
        if read_metadata(location) != metadata:
            raise DatasetError(f"{path} was replaced while it was read: read it again")
        raise DatasetError(
            f"{path} is damaged: its {path.stat().st_size} bytes are not those that "
            f"were written; delete it with marl-mm datasets delete {location.name} and "
            "make it again"
        )
    names = tuple(record.get("info", INFO))
    key = cache.Key(digest, record["episodes"], names, layout_in(metadata))
    arrays = cache.cached(key) if cached else None
    if arrays is None:
        arrays = read_apart(path, key.episodes, key.layout, key.info)
        if file_digest(path, DatasetError) != digest:
            raise DatasetError(f"{path} was replaced while it was read: read it again")
        _refuse_problems(problems_of(arrays), path)
        cache.keep(key, arrays)
    _refuse_problems(problems_of_record(metadata, arrays.steps), about)
    return arrays


def _refuse_problems(problems: list[str], path: Path) -> None:
    if problems:
        raise DatasetError(f"{path}: {'; '.join(problems)}")


def _key(digest: str, arrays: EpisodeArrays) -> cache.Key:
    return cache.Key(digest, len(arrays), tuple(arrays.info), arrays.layout)


def _name_namespaces(location: Location) -> None:
    """Write the metadata of the namespace, without which Minari does not list it."""
    folder = Path(location.id).parent
    path = datasets_root() / folder / "namespace_metadata.json"
    if not path.exists():
        write_json(path, {"description": "Datasets made by marl_mm."})
