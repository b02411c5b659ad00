"""Checks of a dataset's files, without the simulator."""

import json
from typing import Any

import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.datasets.card import kept_card
from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.location import Location
from marl_mm.datasets.metadata import read_metadata, statistics
from marl_mm.datasets.storage import read_arrays
from marl_mm.episode import IMPORTED
from marl_mm.errors import DatasetError
from marl_mm.received import read_json


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
        *_counts(arrays, metadata),
        *problems_of(arrays),
        *_infos(arrays),
        *_card(Dataset(location, metadata, arrays)),
    ]


def problems_of(arrays: EpisodeArrays) -> list[str]:
    """Problems of episodes from any source: ranges, goals, ends."""
    return [*_values(arrays), *_ends(arrays)]


def _counts(arrays: EpisodeArrays, metadata: dict[str, Any]) -> list[str]:
    ours = metadata["marl_mm"]
    pairs = {
        "total_episodes": (metadata.get("total_episodes"), len(arrays)),
        "total_steps": (metadata.get("total_steps"), arrays.steps),
        "steps": (ours["steps"], arrays.steps),
    }
    problems = [
        f"metadata.json: {name} is {recorded}, the file has {counted}"
        for name, (recorded, counted) in pairs.items()
        if recorded != counted
    ]
    if json.loads(json.dumps(statistics(arrays))) != ours["statistics"]:
        problems.append("metadata.json: the statistics are not those of the data")
    return problems


def _values(arrays: EpisodeArrays) -> list[str]:
    layout = arrays.layout
    low, high = np.array(layout.low), np.array(layout.high)
    outside = (arrays.actions < low) | (arrays.actions > high)
    least, most = np.array([(entry.low, entry.high) for entry in layout.state]).T
    beyond = ((arrays.states < least) | (arrays.states > most)).any(axis=1)
    moved = np.diff(arrays.states[:, layout.goal], axis=0)[~arrays.is_last_state()[:-1]]
    checks = {
        "actions outside of the action space": outside.any(axis=1).sum(),
        "states outside of their entries' bounds": beyond.sum(),
        "goals that move within an episode": moved.any(axis=1).sum(),
    }
    return [f"{count} {text}" for text, count in checks.items() if count]


def _infos(arrays: EpisodeArrays) -> list[str]:
    """Problems of step numbers: only episodes from files of others may have NaN."""
    ours = np.repeat(arrays.sources != IMPORTED, arrays.lengths)
    counts = {
        key: int((~np.isfinite(values[ours])).sum())
        for key, values in arrays.info.items()
        if values.dtype.kind == "f"
    }
    return [f"{n} values of infos/{key} are NaN" for key, n in counts.items() if n]


def _ends(arrays: EpisodeArrays) -> list[str]:
    last = np.zeros(arrays.steps, bool)
    last[np.cumsum(arrays.lengths) - 1] = True
    ended = arrays.terminated | arrays.truncated
    checks = {
        "steps that end an episode before its last one": (ended & ~last).sum(),
        "episodes that neither reached the goal nor ran out of steps": (
            (~ended & last).sum()
        ),
        "steps that are both terminated and truncated": (
            (arrays.terminated & arrays.truncated).sum()
        ),
    }
    return [f"{count} {text}" for text, count in checks.items() if count]


def _card(dataset: Dataset) -> list[str]:
    """Problems of the card, which may be missing."""
    path = dataset.location.folder / "card.json"
    if not path.exists():
        return []
    again = f"marl-mm datasets show {dataset.location.name} writes it again"
    try:
        kept = read_json(path, DatasetError)
    except DatasetError as error:
        return [f"{error}: {again}"]
    return [] if kept == kept_card(dataset) else [f"{path} is of other data: {again}"]
