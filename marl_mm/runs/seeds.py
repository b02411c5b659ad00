"""Several seeds: one after the other, in processes, or side by side."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from marl_mm.algorithms.checkpoint import FILE, read_checkpoint
from marl_mm.datasets.dataset import Dataset
from marl_mm.errors import DivergedError, WorkerDiedError
from marl_mm.files import only_here
from marl_mm.progress import Bar, distant_bars, show_distant_bars
from marl_mm.runs.checks import check_training
from marl_mm.runs.folder import check_run, run_config
from marl_mm.runs.learning import (
    begin_runs,
    on_engine,
    train_runs,
    with_exact_precision,
)
from marl_mm.runs.training import Offline, Training
from marl_mm.workers import Workers

_Trained = list[Path] | DivergedError
"""Folders of the runs, or why there are none."""


def train_seeds(
    training: Training,
    dataset: Dataset | None,
    runs: Mapping[int, Path],
    bar: Bar,
    *,
    wait: bool = False,
) -> Iterator[Path]:
    """Train and evaluate seeds, each into a folder that is yielded when it is done.

    From a dataset, seeds are trained in processes of their own on a CPU, and all at
    once on a GPU.

    Args:
        training: Settings of the runs.
        dataset: Dataset to learn from, or to replay online, if any.
        runs: Folders by seed.
        bar: Factory of progress bars.
        wait: Whether to wait for another process that is at one of them.

    Raises:
        DatasetError: If there is nothing to learn from.
        DivergedError: At the end, if a seed diverged; see ``algorithms.train.train``.
        KeyboardInterrupt: After Ctrl-C, saying how to go on.
    """
    training = on_engine(with_exact_precision(training), dataset)
    check_training(training, dataset, runs)
    # Those of an incomplete last round go beside the others: no core is idle then.
    processes = min(len(runs), training.workers + len(runs) % training.workers)
    apart = isinstance(training, Offline) and training.device == "cpu"
    with ExitStack() as stack:
        for run in runs.values():
            stack.enter_context(only_here(run, wait=wait))
        for seed, run in runs.items():  # another process may have been faster
            check_run(run, run_config(training, dataset, seed), training)
        begin_runs(training, dataset, runs)
        if training.side_by_side:
            parts: Iterable[_Trained] = _together(training, dataset, runs, bar)
        elif apart and min(processes, training.workers) > 1:
            parts = _apart(training, dataset, runs, processes, bar)
        else:
            parts = (_try(training, dataset, {s: run}, bar) for s, run in runs.items())
        failures = []
        for trained in parts:
            if isinstance(trained, DivergedError):
                failures.append(trained)
            else:
                yield from trained
        if failures:
            raise DivergedError("; ".join(map(str, failures)))


def _apart(
    training: Training,
    dataset: Dataset | None,
    runs: Mapping[int, Path],
    processes: int,
    bar: Bar,
) -> Iterator[_Trained]:
    """Seeds in processes of their own, which Ctrl-C or one that dies stops."""
    context = get_context("forkserver")
    messages, stop = context.Queue(), context.Event()
    arguments = replace(training, workers=1), dataset, messages, stop
    go_on = f"{', '.join(map(str, runs.values()))}: go on with `resume=True`"
    try:
        with (
            show_distant_bars(messages, stop, bar),
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
"""Settings, dataset and channels of a process that trains seeds."""


def _begin_process(*arguments: Any) -> None:
    global _process
    _process = arguments


def _train_in_process(cell: tuple[int, Path]) -> _Trained:
    training, dataset, messages, stop = _process
    return _try(training, dataset, dict([cell]), distant_bars(messages, stop))


def _together(
    training: Training, dataset: Dataset | None, runs: Mapping[int, Path], bar: Bar
) -> Iterator[_Trained]:
    """Seeds side by side in this process, those together that stand at one update."""
    steps: dict[int, dict[int, Path]] = {}
    for seed, run in runs.items():
        begun = (run / FILE).exists()
        step = read_checkpoint(run)["state"].get("step", -1) if begun else -1
        steps.setdefault(step, {})[seed] = run
    for group in steps.values():
        trained = _try(training, dataset, group, bar)
        if isinstance(trained, DivergedError) and len(group) > 1:
            # The others of a group that one seed stopped go on from there.
            for seed, run in group.items():
                yield _try(training, dataset, {seed: run}, bar)
        else:
            yield trained


def _try(
    training: Training, dataset: Dataset | None, runs: Mapping[int, Path], bar: Bar
) -> _Trained:
    """Train; that one seed diverges is no reason to stop others."""
    try:
        return train_runs(training, dataset, runs, bar)
    except DivergedError as error:
        return error
