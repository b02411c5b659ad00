"""From episodes to rows, and from rows to summaries: pure functions."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Required, TypedDict, cast

import numpy as np

from marl_mm.episode import Episode
from marl_mm.errors import MarlMmError
from marl_mm.eval.intervals import success_interval
from marl_mm.registry import Registry

Row = dict[str, Any]
"""A line of a table."""

EvaluationRow = TypedDict(
    "EvaluationRow",
    {
        "index": Required[int],
        "seed": Required[int],
        "goal": Required[list[float]],
        "direction": str,
        "success": Required[bool],
        "steps": Required[int],
        "return": Required[float],
        "final_distance": float,
        "d_mm": float,
        "d_mp": float,
        "base_jerk_rms": float,
        "zmp_margin": float,
        "alpha": float,
        "qp_failures": int,
        "reason": str,
    },
    total=False,
)
"""An episode as numbers; metrics that plug-ins add stand beside these."""

Rows = Sequence[Mapping[str, Any]]
"""Rows of episodes, read-only."""


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A number that describes an episode."""

    about: str
    """Meaning, with its unit."""

    value: Callable[[Episode], float | None]
    """Function of an episode; None where the episode lacks what it needs."""

    averaged: bool = False
    """Whether summaries have the mean over episodes."""

    column: str = ""
    """Head of its column in tables of means, with its unit in brackets; empty where
    they leave it out."""

    form: str = ".3g"
    """Format specification of the number in tables."""

    def measure(self, name: str, episode: Episode) -> float | int | None:
        """The metric's value of an episode, for rows.

        Raises:
            MarlMmError: If the value is no number.
        """
        value = self.value(episode)
        value = value.item() if isinstance(value, np.generic) else value
        if value is None or isinstance(value, int | float):
            return value
        raise MarlMmError(
            f"metric {name!r} is {value!r:.80}, expected a number or None"
        )


_SUMMARIZED = "episodes", "success_rate", "interval", "steps_to_success", "failures"
"""Names of what summaries have beside means of metrics."""

METRICS: Registry[Metric] = Registry(
    "metric",
    of=Metric,
    taken=(
        *EvaluationRow.__required_keys__,
        *("direction", "reason"),
        *_SUMMARIZED,
    ),
)
"""Metrics that evaluations have beside success, steps and return."""


def _of_info(name: str, reduce: Callable[[np.ndarray], Any]) -> Any:
    def value(episode: Episode) -> Any:
        return reduce(episode.info[name]).item() if name in episode.info else None

    return value


def _add(name: str, about: str, value: Any, column: str = "", form: str = "") -> None:
    METRICS.add(name, Metric(about=about, value=value, column=column, form=form))


_add(
    "final_distance",
    "distance to the goal at the end [m]",
    _of_info("distance", lambda values: values[-1]),
)
_add(
    "d_mm",
    "end-effector to its target, mean [m]",
    _of_info("d_mm", np.mean),
    *("d_mm [m]", ".3f"),
)
_add("d_mp", "base to its plan, mean [m]", _of_info("d_mp", np.mean), "d_mp [m]", ".3f")
_add(
    "base_jerk_rms",
    "jerk of the base, mean over steps [m/s^3]",
    _of_info("base_jerk_rms", np.mean),
    *("jerk [m/s^3]", ".2f"),
)
_add("zmp_margin", "least margin of stability [m]", _of_info("zmp_margin", np.min))


def alphas(episode: Episode) -> np.ndarray:
    """Alpha at each step, shape (T,).

    Raises:
        LayoutError: If the layout has none.
    """
    return np.asarray(episode.actions[:, episode.layout.settings("alpha")][:, 0])


def _mean_alpha(episode: Episode) -> float | None:
    if "alpha" not in episode.layout.action_names:
        return None
    return float(alphas(episode).mean())


_add(
    "alpha",
    "alpha, mean: 0 accurate hand ... 1 stable base",
    _mean_alpha,
    *("alpha", ".2f"),
)
_add(
    "qp_failures",
    "levels of the hierarchy without a solution",
    _of_info("qp_failures", np.sum),
)


def episode_row(episode: Episode) -> EvaluationRow:
    """An episode's row.

    ``direction`` where the layout has one; ``reason``, why it failed or nothing, where
    the task can fail.
    """
    reason = {} if episode.reason is None else {"reason": episode.reason}
    direction = episode.direction
    measured = {name: metric.measure(name, episode) for name, metric in METRICS.items()}
    row = {
        "index": episode.index,
        "seed": episode.seed,
        "goal": episode.states[0, episode.layout.goal].tolist(),
        **({} if direction is None else {"direction": direction}),
        "success": episode.success,
        "steps": len(episode),
        "return": episode.episode_return,
        **{name: value for name, value in measured.items() if value is not None},
        **reason,
    }
    return cast(EvaluationRow, row)


def summarize(rows: Rows) -> dict[str, Any]:
    """Success rate with interval, and means over episodes; steps over successes."""
    successes = [row for row in rows if row["success"]]
    steps = [row["steps"] for row in successes]
    summary: dict[str, Any] = {
        "episodes": len(rows),
        "success_rate": len(successes) / len(rows),
        "interval": success_interval(len(successes), len(rows)),
        "steps_to_success": float(np.mean(steps)) if steps else None,
    }
    averaged = [name for name, m in METRICS.items() if m.averaged or m.column]
    for key in ("return", *averaged):
        if values := [row[key] for row in rows if key in row]:
            summary[key] = float(np.mean(values))
    failures = count_failures(rows)
    return summary if failures is None else {**summary, "failures": failures}


def count_failures(rows: Rows) -> dict[str, int] | None:
    """Number of episodes that failed, by reason; None if reasons are not known."""
    if not any("reason" in row for row in rows):
        return None
    reasons = [row["reason"] for row in rows if row.get("reason")]
    kinds = ("collision" if r.startswith("collision") else r for r in reasons)
    return dict(Counter(kinds).most_common())


def failures_in_words(failures: Mapping[str, int]) -> str:
    """Counts of ``count_failures`` as text."""
    return ", ".join(f"{reason} {n}" for reason, n in failures.items()) or "none"


def summarize_directions(rows: Rows) -> dict[str, dict[str, Any]]:
    """Summaries of all rows, of those ahead and of those behind."""
    parts = {"all": list(rows)}
    for direction in ("forward", "backward"):
        parts[direction] = [row for row in rows if row.get("direction") == direction]
    return {name: summarize(part) for name, part in parts.items() if part}
