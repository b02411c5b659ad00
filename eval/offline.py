"""What offline runs show: how well their last checkpoints do, by dataset and setting.

Functions of run folders ``RUNS/DATASET/SETTING/SEED`` and of the rows read from them.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.algorithms.presets import OfflineConfig, Preset, offline_preset
from marl_mm.errors import UsageError
from marl_mm.eval.metrics import Row, success_interval
from marl_mm.eval.online import deviation
from marl_mm.eval.tables import markdown_table


@dataclass(frozen=True)
class Setting:
    """One way to learn from a dataset, run with several seeds."""

    name: str
    """Of its folder and in tables."""

    about: str
    """In tables."""

    algorithm: str = "td3-bc"
    preset: Preset = "tuned"

    changes: dict[str, Any] = field(default_factory=dict)
    """Of the preset's hyper-parameters."""

    goals: int = 200
    """Of the evaluation at the end."""

    also: tuple[str, ...] = ()
    """Datasets on which it is run, beside those of its study."""

    @property
    def config(self) -> OfflineConfig:
        """Its hyper-parameters."""
        return replace(offline_preset(self.algorithm, self.preset), **self.changes)


@dataclass(frozen=True)
class Study:
    """Settings on datasets: a table."""

    about: str
    settings: tuple[Setting, ...]

    datasets: tuple[str, ...]
    """Of the paper, or of another task: marl_mm/reach/NAME-v0."""

    @property
    def cells(self) -> list[tuple[str, Setting]]:
        """Datasets and settings that are run on them, in the order of the table."""
        also = [name for setting in self.settings for name in setting.also]
        return [
            (dataset, setting)
            for dataset in dict.fromkeys((*self.datasets, *also))
            for setting in self.settings
            if dataset in self.datasets or dataset in setting.also
        ]


GOOD = ("good-30k", "good-60k")
MIXES = ("mix-5k-random-5k-medium-20k-good", "mix-10k-random-20k-good")

PAPER = {
    ("good-30k", "td3-bc"): "34 +- 32",
    ("good-60k", "td3-bc"): "26 +- 14",
    (MIXES[0], "td3-bc"): "13 +- 16",
    (MIXES[1], "td3-bc"): "16 +- 17",
    ("good-60k", "mabc"): "78 +- 7",
}
"""Success [%] in the paper's Tables 4 and 5, by dataset and algorithm."""

OTHER_TASKS = {
    "smooth-30k": "marl-mm collect pretrained --task SmoothReach-v0",
    "precise-30k": "marl-mm collect pretrained --task PreciseReach-v0",
}
"""What collects the datasets of other tasks."""


def made_by(dataset: str) -> str:
    """The command that makes a dataset."""
    if dataset not in OTHER_TASKS:
        return "marl-mm collect paper"
    name = f"--steps 30000 --dataset marl_mm/reach/{dataset}-v0"
    return f"{OTHER_TASKS[dataset]} {name}"


_LEARNERS = (
    Setting("mabc", "MABC", "mabc"),
    Setting("td3-bc", "TD3+BC", "td3-bc"),
    Setting("matd3-bc", "MATD3+BC", "matd3-bc"),
)

_FEWER = 100
"""Goals of what is only compared."""

_UPDATES = {"updates": offline_preset("td3-bc").updates}
"""As many as in the rows that literal ones are compared with; Table 3 has 100,000."""


def _cure(name: str, about: str, **changes: Any) -> Setting:
    """TD3+BC's tuned preset with one choice another."""
    return Setting(f"td3-bc-{name}", f"TD3+BC, {about}", changes=changes, goals=_FEWER)


def _multi(name: str, about: str, **changes: Any) -> Setting:
    """MATD3+BC's tuned preset with one choice another."""
    return Setting(
        f"matd3-bc-{name}",
        f"MATD3+BC, {about}",
        "matd3-bc",
        changes=changes,
        goals=_FEWER,
    )


_UNSCALED = replace(
    _cure("unscaled", "imitation not scaled by spread", imitation_scaled=False),
    also=("pd-30k",),
)

_CURES = (
    Setting(
        "td3-bc-literal",
        "TD3+BC as in the paper, c = 2.5",
        "td3-bc",
        "paper",
        _UPDATES,
        _FEWER,
    ),
    Setting(
        "td3-bc-literal-c0.5",
        "TD3+BC as in the paper, but c = 0.5",
        "td3-bc",
        "paper",
        {**_UPDATES, "q_weight": 0.5},
        _FEWER,
    ),
    Setting("td3-bc", "TD3+BC, tuned", also=("pd-30k",)),
    _cure("c2.5", "c = 2.5", q_weight=2.5),
    _cure("c1", "c = 1", q_weight=1.0),
    _cure("c0.1", "c = 0.1", q_weight=0.1),
    _cure("c-falls", "c from 2.5 to 0.1", q_weight=2.5, q_weight_end=0.1),
    _cure("no-clip", "targets not cut off", clip_targets=False),
    _cure("no-layer-norm", "no layer norm", layer_norm=False),
    _cure("own-goals", "own goals only", future=0.0, elsewhere=0.0),
    _cure("no-elsewhere", "no other episodes' goals", elsewhere=0.0),
    _cure("no-future", "no goals of later steps", future=0.0),
    _cure("better", "better actions imitated", imitate="better"),
    _cure("all", "all episodes imitated", imitate="all"),
    _UNSCALED,
    _cure("a-x", "delta_x imitated fourfold", imitation_weights=(4.0, 1.0, 1.0, 1.0)),
    Setting(
        "matd3-bc-literal",
        "MATD3+BC as in the paper, c = 2.5",
        "matd3-bc",
        "paper",
        _UPDATES,
        _FEWER,
    ),
    Setting("matd3-bc", "MATD3+BC, tuned", "matd3-bc"),
    _multi("own", "a critic for each agent", critics="own"),
    _multi("data", "others' actions from the data", others="data"),
)

STUDIES = {
    "offline": Study(
        "Table: MABC, TD3+BC and MATD3+BC on the paper's datasets.",
        _LEARNERS,
        (*GOOD, "pd-30k", *MIXES),
    ),
    "tasks": Study(
        "Table: the same on SmoothReach-v0 and PreciseReach-v0.",
        _LEARNERS,
        tuple(OTHER_TASKS),
    ),
    "cures": Study(
        "Table: why TD3+BC and MATD3+BC fail, and what cures them.",
        _CURES,
        ("good-30k", "mix-10k-random-20k-good"),
    ),
}
"""By the name of the target of ``marl-mm ablate``."""


def evaluation_rows(runs: Path, dataset: str, setting: str, seed: int) -> Iterator[Row]:
    """A run's last evaluation: one row per goal.

    Raises:
        UsageError: If there is none.
    """
    path = runs / dataset / setting / str(seed) / "eval.json"
    if not path.exists():
        raise UsageError(f"{path} is missing: train the run to its end first")
    evaluation = json.loads(path.read_text())
    head = {
        "dataset": dataset,
        "task": evaluation["task"],
        "setting": setting,
        "seed": seed,
    }
    kept = ("direction", "success", "steps", "return", "d_mm", "d_mp", "alpha")
    for row in evaluation["episodes"]:
        own = {key: row[key] for key in kept} | {"success": int(row["success"])}
        yield head | {"goal": row["index"]} | own


def summarize(evaluations: Sequence[Row]) -> list[Row]:
    """One row per dataset and setting, in the order in which they come."""
    cells = dict.fromkeys((row["dataset"], row["setting"]) for row in evaluations)
    return [_summarize(evaluations, *cell) for cell in cells]


def _summarize(evaluations: Sequence[Row], dataset: str, setting: str) -> Row:
    own = [
        row
        for row in evaluations
        if (row["dataset"], row["setting"]) == (dataset, setting)
    ]
    seeds = sorted({row["seed"] for row in own})
    rates = [
        float(np.mean([row["success"] for row in own if row["seed"] == seed]))
        for seed in seeds
    ]
    summary: Row = {
        "dataset": dataset,
        "task": own[0]["task"],
        "setting": setting,
        "seeds": len(seeds),
        "goals": len(own) // len(seeds),
        "success": float(np.mean(rates)),
        "success_std": deviation(rates),
        "success_interval": success_interval(
            sum(row["success"] for row in own), len(own)
        ),
        "success_seeds": " ".join(f"{100 * rate:.1f}" for rate in rates),
    }
    for key in ("return", "d_mm", "d_mp", "alpha"):
        summary[key] = float(np.mean([row[key] for row in own]))
    return summary


def offline_table(summary: Sequence[Row], settings: Sequence[Setting]) -> str:
    """One row per dataset and setting, as Markdown."""
    by_name = {setting.name: setting for setting in settings}
    lines = []
    for row in summary:
        setting = by_name[row["setting"]]
        mean, std = 100 * row["success"], 100 * row["success_std"]
        low, high = (100 * bound for bound in row["success_interval"])
        lines.append(
            (
                row["dataset"],
                setting.about,
                f"{mean:.1f} +- {std:.1f} [{low:.1f}, {high:.1f}]",
                str(row["success_seeds"]).replace(" ", ", "),
                str(row["goals"]),
                PAPER.get((row["dataset"], setting.name.removesuffix("-literal")), ""),
                f"{row['return']:.2f}",
                f"{row['d_mm']:.3f}",
                f"{row['d_mp']:.3f}",
                f"{row['alpha']:.2f}",
            )
        )
    header = (
        "dataset",
        "setting",
        "goals reached [%]",
        "every seed",
        "goals",
        "paper",
        "return",
        "d_mm [m]",
        "d_mp [m]",
        "alpha",
    )
    return markdown_table(header, lines)
