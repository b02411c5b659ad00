"""Runs that learn, from a dataset or online: their training and evaluation."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

from marl_mm.algorithms.checkpoint import BEST, FILE
from marl_mm.algorithms.fine_tune import fine_tune
from marl_mm.algorithms.online import train_online
from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.algorithms.runlog import CurvePoint, read_metrics
from marl_mm.algorithms.speed import resolved, small_networks
from marl_mm.algorithms.train import resume, resume_seeds, train
from marl_mm.datasets.dataset import Dataset
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.envs.slots import threads_serve
from marl_mm.envs.task import Task
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import Evaluation, evaluate, evaluate_with
from marl_mm.files import only_here, write_json
from marl_mm.progress import Advance, Bar, silent
from marl_mm.runs.folder import (
    BEST_EVALUATION,
    CURVE,
    EVALUATION,
    begin_run,
    goes_on,
    read_evaluation,
    run_config,
    task_of,
)
from marl_mm.runs.settings import check_device
from marl_mm.runs.starts import copy_start, start_hash, start_of
from marl_mm.runs.training import Offline, Online, Training
from marl_mm.sim.config import default_engine, engine_of

T = TypeVar("T")
Trained = TypeVar("Trained", bound=Training)

# --- Training ----------------------------------------------------------------


def with_exact_precision(training: Trained) -> Trained:
    """Settings that say what ``precision="auto"`` means on this machine.

    A run goes on with that elsewhere, too.

    Raises:
        UsageError: If it is to be on a GPU, and there is none.
    """
    if not isinstance(training, Offline):
        return training
    check_device(training.device)
    precision = resolved(training.config.precision, training.device)
    return replace(training, config=replace(training.config, precision=precision))


def on_engine(training: Trained, dataset: Dataset | None) -> Trained:
    """Settings that name the engine: the dataset's, where none is asked for.

    Raises:
        UsageError: If demonstrations are of another engine.
    """
    if dataset is None:
        return replace(training, engine=training.engine or default_engine())
    given = engine_of(dataset.provenance.overrides)
    engine = training.engine or given
    if isinstance(training, Online) and engine != given:
        raise UsageError(
            f"`demonstrations` {training.demonstrations} is of engine {given}, "
            f"expected {engine}"
        )
    return replace(training, engine=engine)


def algorithm_of(
    training: Training, dataset: Dataset | None, seeds: Sequence[int]
) -> Any:
    """An algorithm before its first update: offline for several seeds at once."""
    learner = ALGORITHMS.get(training.algorithm).learner
    if isinstance(training, Offline):
        assert dataset is not None
        judge = make_task(dataset.provenance.task)
        return learner(training.config, dataset.arrays, judge, seeds, training.device)
    task = make_task(task_of(training, dataset), training.overrides)
    (seed,) = seeds
    episodes = () if dataset is None else dataset.episodes
    return learner(training.config, task, seed, episodes, task.layout)


def begin_runs(
    training: Training, dataset: Dataset | None, runs: Mapping[int, Path]
) -> None:
    """Make the folders of runs, or note in them what they go on with."""
    for seed, run in runs.items():
        config = run_config(training, dataset, seed)
        start = None
        if isinstance(training, Offline) and not goes_on(run, training):
            start = training.start and start_of(training.start, seed)
        if not start:
            begin_run(run, config, training)
            continue
        with only_here(start, wait=True):  # or it may be trained meanwhile
            settings = {**config.settings, **start_hash(start)}
            begin_run(run, replace(config, settings=settings), training)
            copy_start(start, run)


def train_run(
    training: Training, dataset: Dataset | None, seed: int, run: Path, bar: Bar
) -> None:
    """Train and evaluate one seed here, after another process that may be at it.

    Raises:
        DivergedError: If it diverged; its last checkpoint is as it was.
    """
    with only_here(run, wait=True):
        begin_runs(training, dataset, {seed: run})
        train_runs(training, dataset, {seed: run}, bar)


@small_networks()
def train_runs(
    training: Training, dataset: Dataset | None, runs: Mapping[int, Path], bar: Bar
) -> list[Path]:
    """Train runs that have begun, side by side, then evaluate one after the other.

    Online there is a single run. For the arguments see ``seeds.train_seeds``.
    """
    algorithm, folders = algorithm_of(training, dataset, [*runs]), [*runs.values()]
    if any((run / FILE).exists() for run in folders):
        if isinstance(training, Offline):
            resume_seeds(algorithm, folders, [training.clock])
        else:
            resume(algorithm, folders[0], [training.clock])
    name = task_of(training, dataset)
    total = getattr(training.config, training.clock)
    advance = bar(f"{algorithm.name} {' '.join(map(str, runs))}", total)
    made = make_task(name, training.overrides)
    with Rollouts(made, training.workers) as rollouts:

        def point(
            policy: LearnedPolicy,
            rollouts: Rollouts = rollouts,
            advance: Advance = silent,
        ) -> CurvePoint:
            evaluation = evaluate_with(
                rollouts,
                policy,
                training.curve_episodes,
                training.eval_seed + 1,  # other goals than those of the last evaluation
                name,
                training.overrides,
                advance,
            )
            return curve_point(evaluation)

        if isinstance(training, Offline):
            train(
                algorithm,
                folders,
                point,
                training.curve_every,
                advance,
                training.stop_diverging,
                training.logger,
            )
            if training.fine_tuning.online_steps:
                (seed,) = runs
                fine_tune(
                    algorithm,
                    folders[0],
                    training.fine_tuning,
                    partial(rollouts.train, seed),
                    point,
                    bar(f"online {seed}", training.fine_tuning.online_steps),
                    training.stop_diverging,
                    training.logger,
                )
        elif isinstance(training, Online):
            with _beside(made, training.workers, point) as begin:
                train_online(
                    algorithm,
                    folders[0],
                    partial(rollouts.train, next(iter(runs))),
                    point,
                    training.schedule,
                    advance,
                    training.logger,
                    begin,
                )
    for seed, run in runs.items():
        evaluate_run(training, dataset, run, bar, f"eval {seed}")
    return folders


@contextmanager
def _beside(
    task: Task, workers: int, point: Callable[[LearnedPolicy, Rollouts, Advance], T]
) -> Iterator[Callable[[LearnedPolicy], Future[T]] | None]:
    """A function that begins an evaluation in a thread while the updates go on.

    None where threads do not serve: processes of its own would take longer to start.
    """
    if workers == 1 or not threads_serve(task, workers):
        yield None
        return
    stopped = threading.Event()

    def unless_stopped(done: int, note: str) -> None:
        if stopped.is_set():
            raise CancelledError

    with Rollouts(task, workers - 1) as rollouts, ThreadPoolExecutor(1) as thread:
        try:
            yield lambda policy: thread.submit(point, policy, rollouts, unless_stopped)
        finally:
            stopped.set()


def curve_point(evaluation: Evaluation) -> CurvePoint:
    """The numbers of an evaluation that a learning curve keeps."""
    point: dict[str, float] = {}
    for name, part in evaluation.summary.items():
        point[f"success/{name}"] = part["success_rate"]
        point[f"return/{name}"] = part["return"]
        if "alpha" in part:
            point[f"alpha/{name}"] = part["alpha"]
    return cast(CurvePoint, point)


# --- Evaluation --------------------------------------------------------------


def evaluate_run(
    training: Training, dataset: Dataset | None, run: Path, bar: Bar, label: str
) -> None:
    """Draw a trained run's learning curve; evaluate its last policy, online its best.

    With ``resume``, an evaluation of as many goals of the same seed is not repeated;
    ``begin_run`` deletes those of a run that goes further.

    Raises:
        KeyboardInterrupt: After Ctrl-C, saying how to go on.
    """
    from marl_mm.eval import figures  # matplotlib takes half a second

    online = isinstance(training, Online)
    draw = figures.online_curve if online else figures.learning_curve
    draw(read_metrics(run), run / CURVE)
    kept = {FILE: EVALUATION, BEST: BEST_EVALUATION} if online else {FILE: EVALUATION}
    asked = training.eval_episodes, training.eval_seed
    for file, result in kept.items():
        saved = read_evaluation(run / result) if training.resume else None
        if saved is not None and (len(saved.rows), saved.seed) == asked:
            continue
        try:
            evaluation = evaluate(
                load_policy(run / file),
                *asked,
                task_of(training, dataset),
                training.overrides,
                training.workers,
                bar(f"{label} best" if file == BEST else label, training.eval_episodes),
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"stopped; {run} is trained: evaluate it with `resume=True`"
            ) from None
        write_json(run / result, evaluation.to_json())
