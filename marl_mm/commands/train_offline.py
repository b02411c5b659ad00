"""Runs that learn from a dataset file: seeds in processes, or side by side."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from marl_mm.algorithms.checkpoint import FILE, read_checkpoint
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.runlog import CurvePoint, read_metrics
from marl_mm.algorithms.speed import prepare_for_small_networks
from marl_mm.algorithms.train import resume_seeds, train
from marl_mm.commands.offline_options import (
    CONTINUED,
    Offline,
    check_offline,
    offline_algorithm,
    offline_config,
    task_of,
    with_exact_precision,
)
from marl_mm.commands.runs import (
    CURVE,
    EVALUATION,
    continue_run,
    curve_point,
    evaluate_run,
    plugins_of,
    start_run,
)
from marl_mm.datasets.dataset import Dataset
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.errors import DivergedError, WorkerDiedError
from marl_mm.eval.evaluate import Evaluation, evaluate_with
from marl_mm.files import only_here
from marl_mm.progress import Bar, distant_bars, progress_bars, show_distant_bars
from marl_mm.workers import Workers

_Trained = list[tuple[Path, Evaluation]] | DivergedError
"""Runs and their evaluations, or why there are none."""


def train_offline(
    dataset: Dataset, options: Offline[Any], runs: Mapping[int, Path]
) -> Iterator[tuple[Path, Evaluation]]:
    """Train, evaluate, and leave a folder of each seed's run, as they come.

    On a CPU seeds are trained in processes of their own, and on a GPU all at once.

    Raises:
        DatasetError: If there is nothing to learn from.
        DivergedError: At the end, if a seed diverged; see ``algorithms.train.train``.
        KeyboardInterrupt: After Ctrl-C, saying how to go on.
    """
    options = with_exact_precision(options)
    check_offline(dataset, options, runs)
    # Those of an incomplete last round go beside the others: no core is idle then.
    processes = min(len(runs), options.workers + len(runs) % options.workers)
    with ExitStack() as stack:
        for run in runs.values():
            stack.enter_context(only_here(run))
        _begin(dataset, options, runs)
        if options.device == "cuda":
            parts: Iterable[_Trained] = _together(dataset, options, runs)
        elif min(processes, options.workers) > 1:
            parts = _apart(dataset, options, runs, processes)
        else:
            parts = (_here(dataset, options, {s: run}) for s, run in runs.items())
        failures = []
        for trained in parts:
            if isinstance(trained, DivergedError):
                failures.append(trained)
            else:
                yield from trained
        if failures:
            raise DivergedError("; ".join(map(str, failures)))


def train_offline_run(
    dataset: Dataset, options: Offline[Any], seed: int, run: Path, bar: Bar
) -> Evaluation:
    """One seed, in this process, and after another process that may be at it.

    Raises:
        DivergedError: If it diverged; its last checkpoint is as it was.
    """
    with only_here(run, wait=True):
        _begin(dataset, options, {seed: run})
        ((_, evaluation),) = _train(dataset, options, {seed: run}, bar)
    return evaluation


def _begin(dataset: Dataset, options: Offline[Any], runs: Mapping[int, Path]) -> None:
    """Make the folders of runs, or note in them what they go on with."""
    for seed, run in runs.items():
        if options.resume and (run / FILE).exists():
            plugins = plugins_of(options.algorithm, task_of(dataset, options))
            continue_run(run, plugins, {"updates": options.config.updates})
        else:
            start_run(run, offline_config(dataset, options, seed))


def _apart(
    dataset: Dataset, options: Offline[Any], runs: Mapping[int, Path], processes: int
) -> Iterator[_Trained]:
    """Seeds in processes of their own, which Ctrl-C or one that dies stops."""
    context = get_context("forkserver")
    messages, stop = context.Queue(), context.Event()
    alone = replace(options, workers=1)
    arguments = dataset, alone, messages, stop
    go_on = f"{', '.join(map(str, runs.values()))}: go on with --resume"
    try:
        with (
            show_distant_bars(messages),
            Workers(processes, _begin_process, arguments) as pool,
        ):
            try:
                yield from pool.completed(_train_in_process, runs.items(), ahead=1)
            except BaseException:
                stop.set()
                raise
    except WorkerDiedError as error:
        raise WorkerDiedError(f"{error}; {go_on}") from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; {go_on}") from None


_process: tuple[Any, ...] = ()
"""What a process that trains seeds was begun with."""


def _begin_process(*arguments: Any) -> None:
    global _process
    _process = arguments


def _train_in_process(cell: tuple[int, Path]) -> _Trained:
    dataset, options, messages, stop = _process
    return _try(dataset, options, dict([cell]), distant_bars(messages, stop))


def _together(
    dataset: Dataset, options: Offline[Any], runs: Mapping[int, Path]
) -> Iterator[_Trained]:
    """Seeds side by side in this process, those together that stand at one update."""
    steps: dict[int, dict[int, Path]] = {}
    for seed, run in runs.items():
        begun = (run / FILE).exists()
        step = read_checkpoint(run)["state"]["step"] if begun else -1
        steps.setdefault(step, {})[seed] = run
    for group in steps.values():
        trained = _here(dataset, options, group)
        if isinstance(trained, DivergedError) and len(group) > 1:
            # The others of a group that one seed stopped go on from there.
            alone = ({seed: run} for seed, run in group.items())
            yield from (_here(dataset, options, one) for one in alone)
        else:
            yield trained


def _here(
    dataset: Dataset, options: Offline[Any], runs: Mapping[int, Path]
) -> _Trained:
    with progress_bars() as bar:
        return _try(dataset, options, runs, bar)


def _try(
    dataset: Dataset, options: Offline[Any], runs: Mapping[int, Path], bar: Bar
) -> _Trained:
    """Train; that one seed diverges is no reason to stop others."""
    try:
        return _train(dataset, options, runs, bar)
    except DivergedError as error:
        return error


def _train(
    dataset: Dataset, options: Offline[Any], runs: Mapping[int, Path], bar: Bar
) -> list[tuple[Path, Evaluation]]:
    """Train what has been started, and evaluate one seed after the other."""
    prepare_for_small_networks()
    algorithm = offline_algorithm(dataset, options, list(runs))
    if any((run / FILE).exists() for run in runs.values()):
        resume_seeds(algorithm, list(runs.values()), CONTINUED)
    task = task_of(dataset, options)
    label = f"{algorithm.name} {' '.join(map(str, runs))}"
    advance = bar(label, options.config.updates)
    own = make_task(task, options.overrides)
    with Rollouts(own, options.workers) as rollouts:

        def point(policy: LearnedPolicy) -> CurvePoint:
            goals = options.eval_seed + 1  # not those of the final evaluation
            count = options.curve_episodes
            return curve_point(
                evaluate_with(rollouts, policy, count, goals, task, options.overrides)
            )

        train(
            algorithm,
            list(runs.values()),
            point,
            options.curve_every,
            advance,
            options.stop_unsound,
        )
    return [
        (run, evaluate_offline_run(dataset, options, run, bar, f"eval {seed}"))
        for seed, run in runs.items()
    ]


def evaluate_offline_run(
    dataset: Dataset, options: Offline[Any], run: Path, bar: Bar, label: str
) -> Evaluation:
    """Draw a trained run's learning curve; evaluate its last policy."""
    from marl_mm.eval.figures import learning_curve  # matplotlib takes half a second

    learning_curve(read_metrics(run), run / CURVE)
    task, overrides = task_of(dataset, options), options.overrides
    return evaluate_run(run, options, task, FILE, EVALUATION, bar, label, overrides)
