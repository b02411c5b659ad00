"""What holds of all episodes, wherever they come from: ranges, goals, ends."""

import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays


def problems_of(arrays: EpisodeArrays) -> list[str]:
    """Problems of episodes from any source: ranges, goals, ends."""
    return [*_values(arrays), *_ends(arrays)]


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
