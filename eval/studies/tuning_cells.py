"""Runs of the tuning: which settings are tried, and what one of them gives."""

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

from marl_mm.algorithms.registry import preset
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.declared import as_record
from marl_mm.errors import DivergedError, UsageError
from marl_mm.eval.metrics import Row
from marl_mm.eval.selection import UPDATES, Scores, scores
from marl_mm.eval.studies.tuning_ranges import RANGES
from marl_mm.progress import silent_bar
from marl_mm.runs.recipes import RECIPES
from marl_mm.runs.run import Run
from marl_mm.runs.settings import with_settings
from marl_mm.runs.train import trained
from marl_mm.runs.training import Offline
from marl_mm.sim.config import engine_overrides

_DIVERGED: Row = {
    **{"success": 0.0, "return": -math.inf, "critic": math.nan},
    **dict.fromkeys(Scores._fields, math.nan),
}
"""Numbers of a run that diverged."""

_SHIPS, _TIMED = "gate-expert", (30, 90)
"""Dataset on which updates are timed, and their numbers; the difference counts."""

_SEED = 7
"""Seed of the goals, which those of results are not."""


@dataclass(frozen=True)
class TuningCell:
    """A run: everything its row depends on."""

    algorithm: str
    """Registered name of the algorithm."""

    number: int
    """Number of the setting; 0 is the preset."""

    changes: tuple[tuple[str, Any], ...]
    """Hyper-parameters that replace the preset's."""

    dataset: str
    """Name of the dataset's recipe."""

    seeds: tuple[int, ...]
    """Seeds of weights and batches."""

    updates: int
    """Number of updates."""

    goals: int
    """Number of goals."""

    hyperparameters: str
    """All hyper-parameters, as JSON: the preset's among them."""

    data: str
    """Fingerprint of the dataset's recipe."""

    @property
    def task(self) -> str:
        """Registered name of the task."""
        return RECIPES.get(self.dataset).source.task

    @property
    def overrides(self) -> dict[str, Any]:
        """Settings of the task that are replaced."""
        return engine_overrides(RECIPES.get(self.dataset).source.engine)

    @property
    def label(self) -> str:
        """Label in the progress bar."""
        return f"{self.algorithm} {self.number} {self.dataset}"


def settings_of(algorithm: str, count: int) -> list[dict[str, Any]]:
    """Hyper-parameters to try: none, and then draws from the ranges, none twice.

    Args:
        algorithm: Registered name of the algorithm.
        count: Number of settings.

    Raises:
        UsageError: If the ranges have fewer.
    """
    ranges, default = RANGES[algorithm], preset(algorithm)
    sizes = [len(values) for values in ranges.values()]
    if prod(sizes) < count:
        raise UsageError(
            f"`tried` is {count}, expected at most {prod(sizes)}: {algorithm} has no "
            "more settings"
        )
    listed: list[dict[str, Any]] = [{}]
    for number in np.random.default_rng(0).permutation(prod(sizes)):
        places = np.unravel_index(number, sizes)
        pairs = zip(ranges.items(), places, strict=True)
        drawn = {name: values[place] for (name, values), place in pairs}
        if any(getattr(default, name) != value for name, value in drawn.items()):
            listed.append(drawn)
    return listed[:count]


def cell_of(
    algorithm: str,
    number: int,
    changes: Mapping[str, Any],
    dataset: str,
    seeds: tuple[int, ...],
    updates: int,
    goals: int,
) -> TuningCell:
    """A run; arguments are the fields of ``TuningCell``."""
    default = replace(preset(algorithm), updates=updates)
    config = with_settings(algorithm, default, changes)
    return TuningCell(
        algorithm,
        number,
        tuple(changes.items()),
        dataset,
        seeds,
        updates,
        goals,
        json.dumps(as_record(config)),
        RECIPES.get(dataset).fingerprint,
    )


def run_cell(cell: TuningCell) -> list[Row]:
    """Train and evaluate; a row per seed, without success where one diverged."""
    default = replace(preset(cell.algorithm), updates=cell.updates)
    training = Offline(
        algorithm=cell.algorithm,
        config=with_settings(cell.algorithm, default, dict(cell.changes)),
        eval_episodes=cell.goals,
        eval_seed=_SEED,
        curve_every=cell.updates,
        curve_episodes=1,
        stop_diverging=False,
        logger=(),
    )
    data = load_dataset(cell.dataset)
    try:
        measured = _measured(training, data, cell.seeds)
    except DivergedError:  # of one of them
        measured = {}
        for seed in cell.seeds:
            with suppress(DivergedError):
                measured |= _measured(training, data, (seed,))
    return [
        {
            "algorithm": cell.algorithm,
            "setting": cell.number,
            "dataset": cell.dataset,
            "seed": seed,
            **measured.get(seed, _DIVERGED),
            "changes": json.dumps(dict(cell.changes)),
        }
        for seed in cell.seeds
    ]


def seconds_per_update(cell: TuningCell) -> float:
    """Time of an update and one of the scores' critics [s], on data that ships."""

    def seconds(updates: int) -> float:
        short = replace(cell, dataset=_SHIPS, seeds=(0,), updates=updates, goals=2)
        begun = process_time()
        try:
            run_cell(short)
        except KeyboardInterrupt:  # of a run that is thrown away
            raise KeyboardInterrupt from None
        return process_time() - begun

    few, more = _TIMED
    seconds(few)  # compiles, and loads what is used once
    return (seconds(more) - seconds(few)) / (more - few)


def _measured(training: Offline, data: Dataset, seeds: Sequence[int]) -> dict[int, Row]:
    """Success, return and scores of the runs of seeds, by seed."""
    with TemporaryDirectory() as folder:
        runs = list(trained(training, data, Path(folder), seeds, silent_bar))
        tried = min(UPDATES, training.config.updates)
        return {
            seed: _row(run, scores(run.policy, data.arrays, updates=tried))
            for seed, run in zip(seeds, runs, strict=True)
        }


def _row(run: Run, scored: Scores) -> Row:
    summary = run.evaluated.summary["all"]
    values = [row["q/policy"] for row in run.metrics if "q/policy" in row]
    return {
        "success": summary["success_rate"],
        "return": summary["return"],
        "critic": values[-1] if values else math.nan,
        **scored._asdict(),
    }
