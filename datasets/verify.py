"""Checks of a dataset's files, without the simulator."""

import json
from typing import Any

import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.datasets.card import LATER, kept_card
from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.location import Location
from marl_mm.datasets.metadata import read_metadata, statistics
from marl_mm.datasets.plausible import problems_of_task
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import read_arrays
from marl_mm.episode import IMPORTED
from marl_mm.errors import DatasetError
from marl_mm.received import check_kind, read_json


def verify(location: Location) -> list[str]:
    """Check schema, hashes, finiteness, ranges, ends and card of a dataset.

    Returns:
        One line per problem; empty if all is well.

    Raises:
        UnknownDatasetError: If there is no such dataset.
    """
    try:
        metadata = read_metadata(location)
        arrays = read_arrays(location, metadata, cached=False)
    except DatasetError as error:
        return [str(error)]
    return [
        *_statistics(arrays, metadata),
        *_infos(arrays),
        *_task(arrays, metadata),
        *_card(Dataset(location, metadata, arrays)),
    ]


def _statistics(arrays: EpisodeArrays, metadata: dict[str, Any]) -> list[str]:
    recorded = metadata["marl_mm"]["statistics"]
    if json.loads(json.dumps(statistics(arrays))) == recorded:
        return []
    return ["metadata.json: the statistics are not those of the data"]


def _task(arrays: EpisodeArrays, metadata: dict[str, Any]) -> list[str]:
    provenance = Provenance.from_json(metadata["marl_mm"])
    problems = problems_of_task(provenance.task, provenance.overrides, arrays)
    return [f"metadata.json: {problem}" for problem in problems]


def _infos(arrays: EpisodeArrays) -> list[str]:
    """Problems of step numbers: only episodes from files of others may have NaN."""
    collected = np.repeat(arrays.sources != IMPORTED, arrays.lengths)
    counts = {
        key: int((~np.isfinite(values[collected])).sum())
        for key, values in arrays.info.items()
        if values.dtype.kind == "f"
    }
    return [f"{n} values of infos/{key} are NaN" for key, n in counts.items() if n]


def _card(dataset: Dataset) -> list[str]:
    """Problems of the card, which may be missing."""
    path = dataset.location.folder / "card.json"
    if not path.exists():
        return []
    if path.is_dir():
        return [f"{path} is a folder, expected a file: delete it"]
    again = f"marl-mm datasets show {dataset.location.name} writes it again"
    try:
        kept = read_json(path, DatasetError)
        check_kind(kept, dict[str, Any], str(path), DatasetError)
    except DatasetError as error:
        return [f"{error}: {again}"]
    expected = kept_card(dataset)
    for key in LATER - kept.keys():
        del expected[key]
    return [] if kept == expected else [f"{path} is of other data: {again}"]
