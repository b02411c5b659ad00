"""What online runs show: learning curves, episodes to a success rate, evaluations.

Functions of run folders ``RUNS/SETTING/SEED`` and of the rows read from them.
"""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.algorithms.registry import TUNED, preset
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.errors import UsageError
from marl_mm.eval.ablation import Reported
from marl_mm.eval.intervals import mean_interval, summarize_success
from marl_mm.eval.metrics import Row

LEVELS = (0.70, 0.95)
"""Success rates to which episodes are counted; the paper's own ends at 70 %."""

CHECKPOINTS = {"last": "eval.json", "best": "eval_best.json"}
"""Evaluations of a run, by checkpoint."""


MADE_OF = "made_of.json"
"""What the runs of each setting were made of, beside their rows; not of all committed
ones it is known."""

SB3 = "sb3-ddpg-her"
"""The setting that is Stable-Baselines3's."""


@dataclass(frozen=True)
class OnlineSetting:
    """One way to learn online, run with several seeds."""

    name: str
    """Of its folder and in tables."""

    about: str
    """In tables."""

    algorithm: str = "ddpg-her"
    preset: str = TUNED
    task: str = "Reach-v0"
    demonstrations: bool = False
    """Whether it replays episodes of an agent that knows how: PD, or the script."""

    changes: dict[str, Any] = field(default_factory=dict)
    """Of the preset's hyper-parameters."""

    library: str = "marl_mm"
    """``marl_mm``, or ``sb3`` for Stable-Baselines3."""

    reported: Reported | None = None
    """What the paper says of it."""

    @property
    def config(self) -> Any:
        """Its hyper-parameters."""
        return replace(preset(self.algorithm, self.preset), **self.changes)


def _departure(name: str, about: str, **changes: Any) -> OnlineSetting:
    """The tuned preset with one hyper-parameter back at Table 2's or the plain one."""
    changes = {"episodes": 300, **changes}
    return OnlineSetting(f"ddpg-her-{name}", f"DDPG + HER, {about}", changes=changes)


_OF_GRASP = 1_000
"""Episodes of runs on Grasp-v0, whatever the preset has."""

_PLAIN = Reported("Sec. 5.4.1", words="under 40")
_HINDSIGHT = Reported("Sec. 5.4.1", words="70 by about episode 90")

SETTINGS = (
    OnlineSetting("ddpg", "DDPG", "ddpg", reported=_PLAIN),
    OnlineSetting("ddpg-her", "DDPG + HER", reported=_HINDSIGHT),
    OnlineSetting("maddpg-her", "MADDPG + HER", "maddpg-her"),
    OnlineSetting("ddpg-paper", "DDPG, Table 2", "ddpg", "paper", reported=_PLAIN),
    OnlineSetting(
        "ddpg-her-paper",
        "DDPG + HER, Table 2",
        "ddpg-her",
        "paper",
        reported=_HINDSIGHT,
    ),
    OnlineSetting(SB3, "Stable-Baselines3, DDPG + HER", library="sb3"),
    OnlineSetting(
        "ddpg-demonstrations", "DDPG, demonstrations", "ddpg", demonstrations=True
    ),
    OnlineSetting(
        "ddpg-her-demonstrations", "DDPG + HER, demonstrations", demonstrations=True
    ),
    OnlineSetting("ddpg-her-smooth", "DDPG + HER", task="SmoothReach-v0"),
    OnlineSetting(
        "maddpg-her-smooth", "MADDPG + HER", "maddpg-her", task="SmoothReach-v0"
    ),
    OnlineSetting(
        "ddpg-her-grasp",
        "DDPG + HER",
        task="Grasp-v0",
        changes={"episodes": _OF_GRASP},
    ),
    OnlineSetting(
        "ddpg-her-grasp-demonstrations",
        "DDPG + HER, demonstrations",
        task="Grasp-v0",
        demonstrations=True,
        changes={"episodes": _OF_GRASP},
    ),
    OnlineSetting(
        "maddpg-her-others",
        "MADDPG + HER, others' replayed actions",
        "maddpg-her",
        changes={"others": "replay", "episodes": 300},
    ),
    _departure("no-layer-norm", "no layer norm", layer_norm=False),
    _departure("no-clip", "targets not cut off", clip_targets=False),
    _departure("no-penalty", "no action penalty", action_penalty=0.0),
    _departure("warm-up", "warm-up 5,000", warm_up=5_000, episodes=400),
    _departure("capacity", "replay of 5,000", capacity=5_000),
    _departure("updates", "25 updates an episode", updates_per_episode=25),
    _departure("cycle", "1 episode a cycle", episodes_per_cycle=1),
)
"""What the tables and figures of online learning are made of."""


def curve_rows(runs: Path, setting: str, seed: int) -> list[Row]:
    """A run's learning curve: one row per evaluation."""
    run = runs / setting / str(seed)
    counted = ("episode", "env_steps")
    measured = (  # backward only where goals are behind, too
        "success/all",
        "success/forward",
        "success/backward",
        "return/all",
        "alpha/forward",
        "alpha/backward",
    )
    told_by_ours = (  # once it has learnt; SB3's runs do not have them
        "updates",
        "train/return",
        "train/success",
        "q/data",
        "q/policy",
        "action/saturation",
    )
    rows = [row for row in read_metrics(run) if "success/all" in row]
    if not rows:
        raise UsageError(f"{run} has no evaluations: train it first")
    head: Row = {"setting": setting, "seed": seed}
    return [
        head
        | {k: row[k] for k in counted}
        | {
            k.replace("/", "_"): row.get(k, math.nan)
            for k in (*measured, *told_by_ours)
        }
        for row in rows
    ]


def evaluation_rows(runs: Path, setting: str, seed: int) -> Iterator[Row]:
    """A run's evaluations of its last and its best policy: one row per goal."""
    for checkpoint, file in CHECKPOINTS.items():
        path = runs / setting / str(seed) / file
        if not path.exists():
            raise UsageError(f"{path} is missing: train the run to its end first")
        for row in json.loads(path.read_text())["episodes"]:
            yield {
                "setting": setting,
                "seed": seed,
                "checkpoint": checkpoint,
                "goal": row["index"],
                "direction": row["direction"],
                "success": int(row["success"]),
                "steps": row["steps"],
                "return": row["return"],
                "d_mm": row["d_mm"],
                "d_mp": row["d_mp"],
                "base_jerk_rms": row["base_jerk_rms"],
                "alpha": row["alpha"],
            }


def episodes_to(curve: Sequence[Row], level: float) -> tuple[int, int] | None:
    """When a success rate was reached: between these two counts of episodes.

    They are of the last evaluation before the rate was first shown, 0 if there was
    none, and of the one that showed it; None if none did.
    """
    before = 0
    for row in sorted(curve, key=lambda row: row["episode"]):
        if row["success_all"] >= level:
            return before, row["episode"]
        before = row["episode"]
    return None


def summarize_settings(
    curves: Sequence[Row], evaluations: Sequence[Row], names: Sequence[str]
) -> list[Row]:
    """One row per setting: success at the end and at best, episodes to each level."""
    rows = []
    for name in names:
        own = [row for row in curves if row["setting"] == name]
        seeds = sorted({row["seed"] for row in own})
        by_seed = [[row for row in own if row["seed"] == seed] for seed in seeds]
        row: Row = {"setting": name, "seeds": len(seeds)}
        for checkpoint in CHECKPOINTS:
            goals = [
                one
                for one in evaluations
                if (one["setting"], one["checkpoint"]) == (name, checkpoint)
            ]
            row |= summarize_success(goals, f"success_{checkpoint}")
            row[f"return_{checkpoint}"] = float(
                np.mean([one["return"] for one in goals])
            )
        for level in LEVELS:
            counts = [episodes_to(curve, level) for curve in by_seed]
            row |= _counted(f"to_{round(100 * level)}", counts)
        row["episodes"] = max(curve[-1]["episode"] for curve in by_seed)
        rows.append(row)
    return rows


def _counted(name: str, counts: Sequence[tuple[int, int] | None]) -> Row:
    """Each seed's count, their mean and its interval; nan if one is missing.

    As a count is known to lie between two evaluations only, the interval reaches from
    the lower end of the earlier ones' to the upper end of the later ones'.
    """
    known = [count for count in counts if count is not None]
    complete = len(known) == len(counts)
    shown = [str(count[1]) if count else "-" for count in counts]
    row: Row = {f"{name}_seeds": " ".join(shown)}
    row[name] = float(np.mean([at for _, at in known])) if complete else np.nan
    row[f"{name}_interval"] = (np.nan, np.nan)
    if complete and len(known) > 1:
        low, _ = mean_interval([before for before, _ in known])
        _, high = mean_interval([at for _, at in known])
        row[f"{name}_interval"] = max(0.0, low), high
    return row


def success_at(
    curves: Sequence[Row], setting: OnlineSetting, env_steps: int
) -> list[float]:
    """Every seed's success rate after so many steps, between its evaluations.

    A run that ended when it was flat keeps its last one; one that ended because it was
    to has none, nan.
    """
    own = [row for row in curves if row["setting"] == setting.name]
    rates = []
    for seed in sorted({row["seed"] for row in own}):
        rows = [row for row in own if row["seed"] == seed]
        steps = [0, *(row["env_steps"] for row in rows)]
        successes = [0.0, *(row["success_all"] for row in rows)]
        cut = rows[-1]["episode"] >= setting.config.episodes and env_steps > steps[-1]
        rates.append(np.nan if cut else float(np.interp(env_steps, steps, successes)))
    return rates


def on_a_grid(
    curves: Sequence[Row], setting: str, key: str
) -> tuple[np.ndarray, np.ndarray]:
    """Every seed's curve at common numbers of episodes.

    A run that ended when it was flat keeps its last value. Returns the times, shape
    (t,), and values, shape (seeds, t).
    """
    own = [row for row in curves if row["setting"] == setting]
    seeds = sorted({row["seed"] for row in own})
    times = np.unique([row["episode"] for row in own])
    values = []
    for seed in seeds:
        rows = [row for row in own if row["seed"] == seed]
        values.append(
            np.interp(
                times, [row["episode"] for row in rows], [row[key] for row in rows]
            )
        )
    return times, np.stack(values)
