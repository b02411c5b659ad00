"""From episodes to rows, and from rows to summaries: pure functions."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from marl_mm.episode import Episode
from marl_mm.eval.intervals import success_interval
from marl_mm.layout import ALPHA

Row = dict[str, Any]


def episode_row(episode: Episode) -> Row:
    """One episode as numbers; errors and jerk are means over its steps.

    ``reason``, why it failed or nothing, where there is a block.
    """
    info = episode.info
    told = {} if episode.reason is None else {"reason": episode.reason}
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
        **told,
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
    failures = count_failures(rows)
    return summary if failures is None else {**summary, "failures": failures}


def count_failures(rows: Sequence[Row]) -> dict[str, int] | None:
    """How many episodes ended for which reason; None if that is not known."""
    if not any("reason" in row for row in rows):
        return None
    reasons = [row["reason"] for row in rows if row.get("reason")]
    kinds = ("collision" if r.startswith("collision") else r for r in reasons)
    return dict(Counter(kinds).most_common())


def failures_in_words(failures: Mapping[str, int]) -> str:
    """Counts of ``count_failures``."""
    return ", ".join(f"{reason} {n}" for reason, n in failures.items()) or "none"


def summarize_directions(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Summaries of all rows, of those ahead and of those behind."""
    parts = {"all": list(rows)}
    for direction in ("forward", "backward"):
        parts[direction] = [row for row in rows if row["direction"] == direction]
    return {name: summarize(part) for name, part in parts.items() if part}
