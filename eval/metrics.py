"""From episodes to rows, and from rows to summaries: pure functions."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from marl_mm.episode import Episode
from marl_mm.eval.intervals import success_interval
from marl_mm.layout import ALPHA

Row = dict[str, Any]


def episode_row(episode: Episode) -> Row:
    """One episode as numbers; errors and jerk are means over its steps."""
    info = episode.info
    return {
        "index": episode.index,
        "seed": episode.seed,
        "goal": episode.states[0, episode.layout.goal].tolist(),
        "direction": episode.direction,
        "success": episode.success,
        "steps": len(episode),
        "return": episode.episode_return,
        "final_distance": float(info["distance"][-1]),
        "d_mm": float(info["d_mm"].mean()),
        "d_mp": float(info["d_mp"].mean()),
        "base_jerk_rms": float(info["base_jerk_rms"].mean()),
        "zmp_margin": float(info["zmp_margin"].min()),
        "alpha": float(episode.actions[:, ALPHA].mean()),
        "qp_failures": int(info["qp_failures"].sum()),
    }


def summarize(rows: Sequence[Row]) -> dict[str, Any]:
    """Success rate with interval, and means over episodes; steps over successes."""
    successes = [row for row in rows if row["success"]]
    steps = [row["steps"] for row in successes]
    summary: dict[str, Any] = {
        "episodes": len(rows),
        "success_rate": len(successes) / len(rows),
        "interval": success_interval(len(successes), len(rows)),
        "steps_to_success": float(np.mean(steps)) if steps else None,
    }
    for key in ("return", "d_mm", "d_mp", "base_jerk_rms", "alpha"):
        summary[key] = float(np.mean([row[key] for row in rows]))
    return summary


def summarize_directions(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Summaries of all rows, of those ahead and of those behind."""
    parts = {"all": list(rows)}
    for direction in ("forward", "backward"):
        parts[direction] = [row for row in rows if row["direction"] == direction]
    return {name: summarize(part) for name, part in parts.items() if part}
