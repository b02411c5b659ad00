"""Our metadata of a dataset, under the key ``marl_mm`` of Minari's ``metadata.json``.

They hold layout, provenance, statistics and hashes: one of the data, one of themselves.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.datasets.hdf5 import FILE
from marl_mm.datasets.journal import FILE as JOURNAL
from marl_mm.datasets.location import ID, SHIPPED, Location, datasets_root, known_ids
from marl_mm.datasets.named import name_of, named_ids
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.reference import reference_scores
from marl_mm.errors import DatasetError, LayoutError, UnknownDatasetError, meant
from marl_mm.layout import Layout
from marl_mm.received import check_kind, read_json, refuse_links_out
from marl_mm.version1 import dataset_layout
from marl_mm.versions import versions

OWN_FILES = (
    "data",
    f"data/{FILE}",
    "data/metadata.json",
    "cache",
    "card.json",
    "card.md",
    "card.png",
)
"""Files and folders that a dataset's folder may hold. ``cache``, with arrays in it, is
of version 1 and ignored."""

_MINARI: dict[str, Any] = {"dataset_id": str, "total_episodes": int, "total_steps": int}
_MARL_MM: dict[str, Any] = {
    "data_sha256": str,
    "episodes": int,
    "steps": int,
    "statistics": dict[str, list[float]],
}
"""Types of Minari's fields and ours that are read, beside layout and provenance."""

SUCCESS = "is_success"
"""Step number that every dataset has."""

METADATA_BYTES = 1_000_000
"""Largest size of a dataset's metadata [bytes]; a mix of three has 9,000."""

SCHEMA = 3
"""Version of our metadata; version 2 had no layout, and is read, too."""


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
    refuse_links_out(location.folder, OWN_FILES, DatasetError)
    path = location.data / "metadata.json"
    metadata: dict[str, Any] = read_json(path, DatasetError, METADATA_BYTES)
    record = metadata.get("marl_mm") if isinstance(metadata, dict) else None
    schema = record.get("schema") if isinstance(record, dict) else None
    if not isinstance(record, dict) or schema not in (2, SCHEMA):
        raise DatasetError(
            f"{path} is of no marl_mm dataset of schema 2 or {SCHEMA}: its schema is "
            f"{schema!r}; marl-mm datasets import takes other HDF5 files"
        )
    if record.get("metadata_sha256") != _metadata_digest(metadata):
        raise DatasetError(
            f"{path} is damaged: it is not as it was written; marl-mm datasets import "
            "takes files that were changed on purpose"
        )
    for values, kinds in ((metadata, _MINARI), (record, _MARL_MM)):
        for name, expected in kinds.items():
            check_kind(values.get(name), expected, f"{path}: {name}", DatasetError)
    info = record.get("info", [SUCCESS])
    check_kind(info, list[str], f"{path}: info", DatasetError)
    if SUCCESS not in info:
        raise DatasetError(f"{path}: info lacks {SUCCESS}, which every step has")
    episodes = record["episodes"]
    if not ID.fullmatch(metadata["dataset_id"]) or episodes < 1:
        raise DatasetError(
            f"{path}: dataset_id is {metadata['dataset_id']!r} and episodes "
            f"{episodes}, expected an id such as {SHIPPED} and at least 1"
        )
    attempts = Provenance.from_json(record).attempts
    if attempts is not None and not 0 <= attempts <= 1_000_000 + 1_000 * episodes:
        raise DatasetError(f"{path}: attempts is {attempts} for {episodes} episodes")
    return metadata


def layout_in(metadata: dict[str, Any]) -> Layout:
    """The layout of a dataset's states and actions.

    Raises:
        DatasetError: If the metadata have no layout, or one that makes no sense.
    """
    record = metadata["marl_mm"]
    try:
        if record["schema"] == SCHEMA:
            return Layout.from_json(record.get("layout", {}))
        return dataset_layout(record)
    except LayoutError as error:
        raise DatasetError(f"metadata.json: {error}") from error


def _why_unknown(location: Location) -> str:
    name = location.name
    if (location.working / JOURNAL).exists():
        return (
            f"the collection into {name} was begun and not finished: go on with "
            "`marl_mm.collect(..., resume=True)`"
        )
    where = f" below {datasets_root()}" if name == location.id else ""
    if where and (recipe := name_of(location.id)):
        return f"no dataset {name}{where}: make it with marl-mm datasets build {recipe}"
    ids = filter(ID.fullmatch, known_ids())
    hint = meant(location.id, (SHIPPED, *ids), 0.7)
    hint = hint or meant(location.folder.name.removesuffix("-v0"), named_ids(), 0.8)
    return f"no dataset {name}{where}{hint}: marl-mm datasets list shows all"


def new_metadata(
    location: Location, arrays: EpisodeArrays, provenance: Provenance, digest: str
) -> dict[str, Any]:
    """Metadata of a dataset that is written, without the checksum.

    Args:
        location: Id and folder of the dataset.
        arrays: Arrays of the episodes.
        provenance: Provenance of the episodes.
        digest: SHA-256 of the data file.
    """
    sources = ", ".join(np.unique(arrays.sources).tolist())
    record = {
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
        "marl_mm": record,
    }


def sign_metadata(path: Path) -> None:
    """Store the metadata's checksum inside the metadata."""
    metadata = json.loads(path.read_text("utf-8"))
    metadata["marl_mm"]["metadata_sha256"] = _metadata_digest(metadata)
    path.write_text(json.dumps(metadata), "utf-8")


def _metadata_digest(metadata: dict[str, Any]) -> str:
    record = metadata["marl_mm"].items()
    rest = {key: value for key, value in record if key != "metadata_sha256"}
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
