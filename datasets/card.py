"""A dataset's card: what is in it, as numbers."""

from typing import Any

import numpy as np

from marl_mm.datasets.dataset import Dataset
from marl_mm.layout import ALPHA

_ALPHA_BINS = 5


def card(dataset: Dataset) -> dict[str, Any]:
    """Size, successes, lengths, returns and alphas of a dataset, JSON-serialisable."""
    episodes = dataset.episodes
    ours = dataset.metadata["marl_mm"]
    lengths = [len(episode) for episode in episodes]
    returns = [episode.episode_return for episode in episodes]
    alphas = np.concatenate([episode.actions[:, ALPHA] for episode in episodes])
    histogram, _ = np.histogram(alphas, bins=_ALPHA_BINS, range=(0.0, 1.0))
    return {
        "id": dataset.metadata["dataset_id"],
        "path": str(dataset.location.folder),
        "task": ours.get("task"),
        "collector": ours.get("collector"),
        "seed": ours.get("seed"),
        "complete": ours.get("complete"),
        "attempts": ours.get("attempts"),
        "steps": int(sum(lengths)),
        "episodes": len(episodes),
        "success": {
            direction: _share([e.success for e in episodes if e.direction == direction])
            for direction in ("forward", "backward")
        },
        "episode_length": _spread(lengths),
        "episode_return": _spread(returns),
        "alpha": _spread(alphas),
        "alpha_histogram": histogram.tolist(),
    }


def _share(successes: list[bool]) -> dict[str, Any]:
    rate = float(np.mean(successes)) if successes else None
    return {"episodes": len(successes), "rate": rate}


def _spread(values: Any) -> dict[str, float]:
    return {
        "min": float(np.min(values)),
        "mean": float(np.mean(values)),
        "max": float(np.max(values)),
    }
