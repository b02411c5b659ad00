"""What holds of all episodes, wherever they come from, and of the record about them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.episode import IMPORTED
from marl_mm.errors import MarlMmError
from marl_mm.layout_diff import layout_diff

_LARGEST = 1e12
"""Largest magnitude of states, rewards and starts, in their units. Sums and squares of
them are finite, and coverage counts their cells as integers."""


def problems_of(arrays: EpisodeArrays) -> list[str]:
    """Problems of episodes from any source: sizes, ranges, goals, ends, seeds."""
    return [*_sizes(arrays), *_values(arrays), *_ends(arrays), *_seeds(arrays)]


def problems_of_record(metadata: Mapping[str, Any], steps: int | None) -> list[str]:
    """Problems of the numbers and names that a dataset's metadata hold.

    Args:
        metadata: Metadata of a dataset, of the right types.
        steps: Number of steps of the episodes; None before they are read.
    """
    record = metadata["marl_mm"]
    episodes, info = record["episodes"], record.get("info", [])
    problems = []
    if metadata["total_episodes"] != episodes:
        problems.append(
            f"total_episodes is {metadata['total_episodes']}, but episodes {episodes}"
        )
    counts = {"total_steps": metadata["total_steps"], "steps": record["steps"]}
    problems += [
        f"{name} is {count}, but the episodes have {steps}"
        for name, count in counts.items()
        if steps is not None and count != steps
    ]
    if len(set(info)) < len(info):
        problems.append("info names a step number twice")
    return problems


def problems_of_task(
    task: str, overrides: Mapping[str, Any], arrays: EpisodeArrays
) -> list[str]:
    """Problems of a task's record; of unknown tasks, which plug-ins bring, none.

    Args:
        task: Name of the task that episodes are of.
        overrides: Fields of the task that were replaced.
        arrays: The episodes.
    """
    if task not in TASKS:
        return []
    try:
        layout = make_task(task, overrides).layout
    except (MarlMmError, TypeError, ValueError) as error:
        return [f"overrides make no {task}: {error}"]
    if changes := layout_diff(arrays.layout, layout):
        return [f"the data have another layout than {task}: {'; '.join(changes)}"]
    return []


def _sizes(arrays: EpisodeArrays) -> list[str]:
    parts = {
        "states": arrays.states,
        "actions": arrays.actions,
        "rewards": arrays.rewards[:, None],
        "starts": arrays.starts,
    }
    counts = {
        name: int((np.abs(values) > _LARGEST).any(axis=1).sum())
        for name, values in parts.items()
    }
    too_large = [f"{n} {name} beyond {_LARGEST:g}" for name, n in counts.items() if n]
    del parts["starts"]  # nobody knows those of imported episodes
    of_nan = {name: np.isnan(v).any(axis=1).sum() for name, v in parts.items()}
    return too_large + [f"{n} {name} with a NaN" for name, n in of_nan.items() if n]


def _seeds(arrays: EpisodeArrays) -> list[str]:
    """Problems of the seeds: -1 stands for an unknown one, of imported episodes."""
    least = np.where(arrays.sources == IMPORTED, -1, 0)
    count = int((arrays.seeds < least).sum())
    return [f"{count} seeds below 0"] if count else []


def _values(arrays: EpisodeArrays) -> list[str]:
    layout = arrays.layout
    low, high = _as_stored(layout.low, layout.high)
    outside = (arrays.actions < low) | (arrays.actions > high)
    least, most = _as_stored(
        *zip(*((e.low, e.high) for e in layout.state), strict=True)
    )
    beyond = ((arrays.states < least) | (arrays.states > most)).any(axis=1)
    moved = np.diff(arrays.states[:, layout.goal], axis=0)[~arrays.is_last_state()[:-1]]
    checks = {
        "actions outside of the action space": outside.any(axis=1).sum(),
        "states outside of their entries' bounds": beyond.sum(),
        "goals that move within an episode": moved.any(axis=1).sum(),
    }
    return [f"{count} {text}" for text, count in checks.items() if count]


def _as_stored(
    low: Sequence[float], high: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds that values at them keep when they are stored as float32."""
    return (
        np.minimum(low, np.array(low, np.float32)),
        np.maximum(high, np.array(high, np.float32)),
    )


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
