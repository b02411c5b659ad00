"""Training of a cell's runs: from a dataset, online, or by Stable-Baselines3."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from marl_mm.algorithms.checkpoint import BEST as BEST_FILE
from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.config_checks import Precision
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.schedule import Schedule
from marl_mm.algorithms.speed import (
    finish,
    matrix_products,
    resolved,
    small_networks,
)
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import Location
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.provenance import Provenance
from marl_mm.declared import as_record
from marl_mm.envs.registry import DEFAULT, fewest_steps
from marl_mm.errors import DivergedError
from marl_mm.eval.studies import sb3
from marl_mm.eval.studies.settings import BEST, LAST, Online, Probe, Setting
from marl_mm.plugins import record
from marl_mm.progress import Bar
from marl_mm.runs import learning
from marl_mm.runs.checks import check_training
from marl_mm.runs.seeds import train_seeds
from marl_mm.runs.sources import Data
from marl_mm.runs.training import SWITCHES, Device, Offline, Training
from marl_mm.runs.training import Online as OnlineTraining
from marl_mm.runs.training import training_of as default_training
from marl_mm.sim.config import RECORDED_ENGINE, Engine

_SMALL = {"updates": 120, "episodes": 8, "warm_up": 12, "updates_per_episode": 5}
"""Hyper-parameters with the smoke budget."""

_FEW_OWN = {"online_steps": 8, "online_every": 4, "online_cycle": 1}
"""Own episodes with the smoke budget, where there are some."""

_TIMED = 30
"""Number of timed updates; as many run before them."""

_ONLINE_RUN = 600.0
"""Estimated duration of an online run [s]."""


@dataclass(frozen=True)
class Learner:
    """Training of a cell's runs."""

    training: Training
    """Settings of the runs, with one worker."""

    source: Location | None
    """Location of the dataset or the demonstrations; None without."""

    sb3: bool = False
    """Whether Stable-Baselines3 learns; its interrupted runs start again."""

    @property
    def dataset(self) -> Dataset | None:
        """The dataset, read at each call, as learners are sent to processes."""
        return None if self.source is None else load_dataset(self.source)

    @property
    def task(self) -> str:
        """Task of the evaluations."""
        if isinstance(self.training, OnlineTraining):
            return self.training.task
        assert isinstance(self.training, Offline) and self.source is not None
        if self.training.task is not None:
            return self.training.task
        return Provenance.from_json(read_metadata(self.source)["marl_mm"]).task

    @property
    def probes(self) -> tuple[Probe, ...]:
        """Evaluations that a training ends with."""
        return (LAST,) if isinstance(self.training, Offline) else (LAST, BEST)

    def check(self, runs: Mapping[int, Path]) -> None:
        """Raise before any work is done for what would stop runs, by seed."""
        if not self.sb3:
            check_training(self.training, self.dataset, runs, further=False)
            return
        check_training(self._sb3, None, {})
        for seed, run in runs.items():
            sb3.check_sb3_run(self._sb3, seed, run)

    def train(self, runs: Mapping[int, Path], bar: Bar) -> None:
        """Train and evaluate runs; one that diverges keeps its checkpoint.

        Args:
            runs: Folders by seed: several of those that learn side by side, else one.
            bar: Factory of progress bars.
        """
        training = self.training
        try:
            if training.side_by_side:
                for _ in train_seeds(training, self.dataset, runs, bar, wait=True):
                    pass
                return
            ((seed, run),) = runs.items()
            if self.sb3:
                sb3.train_sb3_run(self._sb3, seed, run, bar)
            else:
                learning.train_run(training, self.dataset, seed, run, bar)
        except DivergedError:
            ends = FILE, BEST_FILE
            if not all((run / file).exists() for run in runs.values() for file in ends):
                raise
            for run in runs.values():
                learning.evaluate_run(training, self.dataset, run, bar, "eval")

    @property
    def _sb3(self) -> OnlineTraining:
        assert isinstance(self.training, OnlineTraining)
        shown = None if self.source is None else self.source.name
        return replace(self.training, demonstrations=shown)

    def seconds_per_update(self, seeds: int) -> float:
        """Measured duration of an update [s]; 0 online.

        Args:
            seeds: Number of seeds; where they learn side by side, the duration is that
                of all over their number.
        """
        if not isinstance(self.training, Offline):
            return 0.0
        training, together = self.training, seeds if self.training.side_by_side else 1
        algorithm = learning.algorithm_of(training, self.dataset, range(together))
        precision = training.config.precision
        with small_networks(), matrix_products(precision, training.device):
            for number in range(2 * _TIMED):
                if number == _TIMED:
                    finish(training.device)
                    begin = perf_counter()
                algorithm.update()
            finish(training.device)
        return (perf_counter() - begin) / _TIMED / together

    def seconds_left(self, run: Path, per_update: float, per_goal: float) -> float:
        """Estimated remaining time of a run's training [s].

        Args:
            run: Folder of the run.
            per_update: Time of an update [s].
            per_goal: Time of an evaluated episode [s].
        """
        training = self.training
        rows = read_metrics(run) if (run / FILE).exists() else []
        if not isinstance(training, Offline):
            done = rows[-1]["episode"] / training.config.episodes if rows else 0.0
            return float(_ONLINE_RUN * (1.0 - done))
        updates = training.config.updates - (rows[-1]["step"] if rows else 0)
        goals = updates / training.curve_every * training.curve_episodes
        own = training.fine_tuning
        goals += own.online_steps / own.online_every * training.curve_episodes
        updates += own.online_steps * own.updates_per_step
        return float(max(updates, 0) * per_update + goals * per_goal)


def training_of(
    source: Data | Online,
    setting: Setting,
    task: str | None,
    small: bool,
    precision: Precision = "auto",
    engine: Engine = RECORDED_ENGINE,
    device: Device = "cpu",
) -> Training:
    """Settings of a cell's runs, without the path of its dataset.

    Args:
        source: Dataset, or episodes of the learner's own.
        setting: Algorithm and hyper-parameters.
        task: Registered name of the dataset's task, if it is known.
        small: Whether hardly anything is trained.
        precision: Precision of matrix products of offline runs.
        engine: Engine of the simulation.
        device: Device of offline training.
    """
    training: Training
    changes = dict(setting.changes)
    if isinstance(source, Online):
        training = default_training(
            setting.algorithm,
            setting.preset,
            task=source.task,
            curve_episodes=setting.curve_goals or 50,
            schedule=Schedule(epoch=4) if small else Schedule(),
        )
    else:
        training = default_training(
            setting.algorithm,
            setting.preset,
            task=setting.task,
            curve_every=setting.curve_every,
            curve_episodes=setting.curve_goals or 20,
            stop_diverging=False,  # a table's runs have all their updates
            fine_tuning=setting.fine_tuning,
            require_success=not small,
            device=device,
        )
        changes = {"precision": resolved(precision, device), **changes}
    run_settings: dict[str, Any] = {"eval_episodes": setting.goals}
    run_settings["max_steps"] = setting.max_steps
    if small:
        changes |= {k: v for k, v in _SMALL.items() if hasattr(training.config, k)}
        steps = fewest_steps(training.task or task or DEFAULT, 4)
        run_settings = {"eval_episodes": 2, "curve_episodes": 2, "max_steps": steps}
        if setting.fine_tuning.online_steps:
            run_settings["fine_tuning"] = replace(setting.fine_tuning, **_FEW_OWN)
    run_settings["engine"] = engine
    config = replace(training.config, **changes)
    return replace(training, config=config, workers=1, resume=True, **run_settings)


def made_of(setting: Setting, training: Training) -> dict[str, Any]:
    """Config that rows must have been made with, without seed and dataset."""
    if setting.library == "sb3":
        assert isinstance(training, OnlineTraining)
        return sb3.made_of(training)
    made = {"algorithm": training.algorithm} | as_record(training.config)
    made |= training.recorded
    if plugins := record(ALGORITHMS.origin(training.algorithm)):
        made["plugins"] = plugins
    task = training.task if isinstance(training, OnlineTraining) else setting.task
    if task is not None:  # else the dataset's
        made["task"] = task
    # Rows are of the device and the precision that were best where they were made.
    others = ("device", "precision", *SWITCHES)
    return {key: made[key] for key in made if key not in others}
