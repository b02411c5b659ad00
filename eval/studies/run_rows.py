"""What a run's folder holds, as rows: evaluated goals and the learning curve."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from marl_mm.algorithms.runlog import read_metrics
from marl_mm.config_diff import as_json
from marl_mm.envs.registry import merged
from marl_mm.errors import MarlMmError
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies.settings import BEST, LAST, Probe
from marl_mm.eval.studies.shown import COLUMNS
from marl_mm.received import damage_named, read_json

_MEASURED = {
    "step": ("steps", "return", "final_distance", "d_mm", "d_mp", "alpha"),
    "episode": ("steps", "return", "d_mm", "d_mp", "base_jerk_rms", "alpha"),
}
"""Columns of evaluated goals, by the clock of the run: updates or episodes."""


def is_probed(
    run: Path, probe: Probe, goals: int, overrides: Mapping[str, Any]
) -> bool:
    """Whether a run has been evaluated so, on as many goals of such a task."""
    path = probe.file(run)
    if not path.exists():
        return False
    evaluation = read_json(path, MarlMmError)
    usual = BEST if path == BEST.file(run) else LAST  # a training's own evaluations
    with damage_named(str(path), MarlMmError):
        return bool(
            len(evaluation["episodes"]) == goals
            and evaluation["overrides"] == as_json(merged(overrides, probe.overrides))
            and evaluation.get("probe", usual.way) == as_json(probe.way)
        )


def goals_of(
    run: Path, seed: int, probe: Probe, measured: Sequence[str] | None
) -> Iterator[Row]:
    """A row per goal of an evaluation of a run.

    Args:
        run: Folder of the run.
        seed: Seed of the run.
        probe: The evaluation.
        measured: Columns beside the success; None for the usual ones of its clock.
    """
    measured = _MEASURED[_clock(run)] if measured is None else measured
    for row in read_json(probe.file(run), MarlMmError)["episodes"]:
        yield {
            "seed": seed,
            "probe": probe.name,
            "goal": row["index"],
            "direction": row.get("direction", ""),
            "success": int(row["success"]),
            **{key: row.get(key, math.nan) for key in measured},
            **{key: row[key] for key in ("reason",) if key in row},
        }


def curve_of(run: Path, seed: int) -> Iterator[Row]:
    """A row per point of a run's learning curve."""
    clock, rows = _clock(run), read_metrics(run)
    own = ("env_steps",) * (clock == "step" and "env_steps" in rows[-1])
    for row in rows:
        if "success/all" in row:
            names = (*COLUMNS[clock], *own)
            values = {k.replace("/", "_"): row.get(k, math.nan) for k in names}
            yield {"seed": seed, clock: row[clock], **values}


def diverged_at(run: Path, config: Mapping[str, Any]) -> int | None:
    """Updates after which a run stopped before its end; None if it did not.

    Args:
        run: Folder of the run.
        config: Its record, with the updates and own steps that were asked for.
    """
    last = read_metrics(run)[-1]
    step = last.get("step", math.inf)
    own = last.get("env_steps", 0) if "step" in last else math.inf
    short = step < config.get("updates", 0) or own < config.get("online_steps", 0)
    return step if short else None


def _clock(run: Path) -> str:
    """Key of a run's progress: ``step``, of updates, or ``episode``."""
    return "episode" if "episode" in read_metrics(run)[0] else "step"
