"""A run that learns from a dataset: its config, what stops it, and its training."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch

from marl_mm.algorithms.algorithm import OfflineAlgorithm
from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.speed import prepare_for_small_networks, resolved
from marl_mm.algorithms.train import resume_seeds, train
from marl_mm.datasets.dataset import Dataset
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.errors import DatasetError, UsageError
from marl_mm.eval.evaluate import Evaluation
from marl_mm.files import only_here
from marl_mm.layout_diff import refuse_other_layout
from marl_mm.progress import Bar
from marl_mm.runs.folder import (
    CURVE,
    EVALUATED,
    EVALUATION,
    check_run,
    continue_run,
    curve,
    evaluate_run,
    plugins_of,
    read_config,
    run_config,
    start_run,
)
from marl_mm.runs.settings import check_positive
from marl_mm.runs.training import Offline

CONTINUED = ("updates",)
"""Settings of a run that may grow when it is resumed: more of it only continues. (The
evaluation at the former end stays in the learning curve.)"""

_MAY_DIFFER = ("preset", "device", "eval_episodes")
"""Settings that may be others when a run is resumed."""


def with_exact_precision(training: Offline) -> Offline:
    """Settings that say what ``precision="auto"`` means on this machine.

    A run goes on with that elsewhere, too.
    """
    precision = resolved(training.config.precision)
    return replace(training, config=replace(training.config, precision=precision))


def check_offline(
    dataset: Dataset,
    training: Offline,
    runs: Mapping[int, Path],
    further: bool = True,
) -> None:
    """Raise before any work is done for what would stop a run; see ``check_run``.

    Args:
        dataset: Episodes to learn from.
        training: Settings of the runs.
        runs: Folders by seed.
        further: Whether runs may go on to more updates than they were to make.
    """
    check_positive(
        curve_every=training.curve_every, curve_episodes=training.curve_episodes
    )
    if training.device == "cuda" and not torch.cuda.is_available():
        raise UsageError(
            "`device` is cuda, but torch finds no such GPU: use `device` cpu, or "
            "install a torch that is built for yours"
        )
    fresh = not all(training.resume and (run / FILE).exists() for run in runs.values())
    if training.require_success and fresh and not dataset.arrays.successes().any():
        others = " (and `imitate` all)" if hasattr(training.config, "imitate") else ""
        raise DatasetError(
            f"none of the {len(dataset.arrays)} episodes of {dataset.location.name} "
            "reaches its goal, so that there is nothing to imitate; with "
            f"`require_success=False`{others} it is tried all the same"
        )
    task = task_of(dataset, training)
    refuse_other_layout(
        dataset.location.name, dataset.arrays.layout, task, make_task(task).layout
    )
    ignored = (*_MAY_DIFFER, *(CONTINUED if further else ()))
    for seed, run in runs.items():
        check_run(run, offline_config(dataset, training, seed), training, ignored)
        if training.resume and (run / FILE).exists():
            _check_end(training, run)
    # Which refuses what it cannot learn from.
    offline_algorithm(dataset, training, list(runs))


def _check_end(training: Offline, run: Path) -> None:
    """Raise if a run cannot go on to the updates asked for."""
    rows, asked = read_metrics(run), training.config.updates
    done = rows[-1]["step"] if rows else 0
    if done > asked:
        raise UsageError(f"{run} has {done} updates already, `updates` is {asked}")
    before = read_config(run).settings["updates"]
    if asked != before and getattr(training.config, "q_weight_end", None) is not None:
        raise UsageError(
            f"{run} was to end at {before} updates, and `q_weight_end` with it: "
            f"`updates` {asked} needs a run of its own"
        )


def offline_algorithm(
    dataset: Dataset, training: Offline, seeds: Sequence[int]
) -> OfflineAlgorithm:
    """An algorithm before its first update, for several seeds at once."""
    judge = make_task(dataset.provenance.task)
    learner = ALGORITHMS.get(training.algorithm).learner
    algorithm: OfflineAlgorithm = learner(
        training.config, dataset.arrays, judge, seeds, training.device
    )
    return algorithm


def task_of(dataset: Dataset, training: Offline) -> str:
    """Name of the task that is evaluated in."""
    return training.task or dataset.provenance.task


def offline_config(dataset: Dataset, training: Offline, seed: int) -> RunConfig:
    """The record of a run."""
    own = "device", "max_steps", "curve_every", "curve_episodes"
    settings = {name: getattr(training, name) for name in (*own, *EVALUATED)}
    return run_config(training, seed, task_of(dataset, training), dataset, settings)


def train_offline_run(
    dataset: Dataset, training: Offline, seed: int, run: Path, bar: Bar
) -> None:
    """Train and evaluate one seed here, after another process that may be at it.

    Raises:
        DivergedError: If it diverged; its last checkpoint is as it was.
    """
    with only_here(run, wait=True):
        begin_runs(dataset, training, {seed: run})
        train_side_by_side(dataset, training, {seed: run}, bar)


def begin_runs(dataset: Dataset, training: Offline, runs: Mapping[int, Path]) -> None:
    """Make the folders of runs, or note in them what they go on with."""
    for seed, run in runs.items():
        if training.resume and (run / FILE).exists():
            plugins = plugins_of(training.algorithm, task_of(dataset, training))
            continue_run(run, plugins, {"updates": training.config.updates})
        else:
            start_run(run, offline_config(dataset, training, seed))


def train_side_by_side(
    dataset: Dataset, training: Offline, runs: Mapping[int, Path], bar: Bar
) -> list[Path]:
    """Train runs that have begun, and evaluate one seed after the other."""
    prepare_for_small_networks()
    algorithm = offline_algorithm(dataset, training, list(runs))
    if any((run / FILE).exists() for run in runs.values()):
        resume_seeds(algorithm, list(runs.values()), CONTINUED)
    task = task_of(dataset, training)
    label = f"{algorithm.name} {' '.join(map(str, runs))}"
    advance = bar(label, training.config.updates)
    own = make_task(task, training.overrides)
    with Rollouts(own, training.workers) as rollouts:
        train(
            algorithm,
            list(runs.values()),
            curve(rollouts, training, task),
            training.curve_every,
            advance,
            training.stop_diverging,
            training.logger,
        )
    for seed, run in runs.items():
        evaluate_offline_run(dataset, training, run, bar, f"eval {seed}")
    return list(runs.values())


def evaluate_offline_run(
    dataset: Dataset, training: Offline, run: Path, bar: Bar, label: str
) -> Evaluation:
    """Draw a trained run's learning curve; evaluate its last policy."""
    from marl_mm.eval.figures import learning_curve  # matplotlib takes half a second

    learning_curve(read_metrics(run), run / CURVE)
    task, overrides = task_of(dataset, training), training.overrides
    return evaluate_run(run, training, task, FILE, EVALUATION, bar, label, overrides)
