"""Checks of a dataset's files, without the simulator."""

import json
from dataclasses import fields
from typing import Any

import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays, load_arrays
from marl_mm.datasets.hdf5 import FILE, achieved_goals
from marl_mm.datasets.location import Location
from marl_mm.datasets.metadata import read_metadata, statistics
from marl_mm.datasets.storage import cache_file, file_digest, read_arrays
from marl_mm.episode import IMPORTED
from marl_mm.errors import DatasetError


def verify(location: Location) -> list[str]:
    """Check schema, hashes, finiteness, ranges, ends, cache and card of a dataset.

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
        *_achieved(arrays, location),
        *_cache(arrays, location),
        *_card(location),
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


def _achieved(arrays: EpisodeArrays, location: Location) -> list[str]:
    achieved = achieved_goals(location.data / FILE, len(arrays))
    count = (achieved != arrays.states[:, arrays.layout.achieved]).any(axis=1).sum()
    text = "achieved goals are not where the hand, or the block, is"
    return [f"{count} {text}"] if count else []


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


def _cache(arrays: EpisodeArrays, location: Location) -> list[str]:
    path = cache_file(location.folder, file_digest(location.data / FILE))
    if not path.exists():
        return []
    try:
        cached = load_arrays(path, arrays.layout)
    except DatasetError as error:
        return [str(error)]
    others = ("info", "layout")
    names = [field.name for field in fields(arrays) if field.name not in others]
    pairs = [(getattr(arrays, name), getattr(cached, name)) for name in names]
    pairs += [(arrays.info[key], cached.info.get(key)) for key in arrays.info]
    equal = all(other is not None and _same(own, other) for own, other in pairs)
    return [] if equal else [f"{path} is not what the data are: delete it"]


def _card(location: Location) -> list[str]:
    path = location.folder / "card.json"
    try:
        if path.exists():
            json.loads(path.read_text())
    except (OSError, ValueError) as error:
        again = f"marl-mm datasets show {location.name} writes it again"
        return [f"{path} is damaged ({error}): {again}"]
    return []


def _same(own: np.ndarray, other: np.ndarray) -> bool:
    """Whether arrays are equal to the bit; texts may differ in their width."""
    if own.dtype.kind == "U":
        return np.array_equal(own, other)
    return own.shape == other.shape and own.tobytes() == other.tobytes()
