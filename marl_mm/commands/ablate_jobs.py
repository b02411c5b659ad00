"""Runs of ablations, each trained and evaluated by one of several processes."""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from time import monotonic
from typing import Any

from marl_mm.algorithms import checkpoint
from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import Location
from marl_mm.errors import DivergedError, MarlMmError, WorkerDiedError
from marl_mm.eval.ablation import LAST, Probe
from marl_mm.eval.alpha_study import FixedAlpha
from marl_mm.eval.evaluate import evaluate
from marl_mm.eval.offline_rows import is_probed, probe_file, probe_way
from marl_mm.files import write_json
from marl_mm.progress import (
    Advance,
    Bar,
    distant_bars,
    progress_bars,
    show_distant_bars,
    silent_bar,
)
from marl_mm.runs.offline import (
    evaluate_offline_run,
    task_of,
    train_offline_run,
)
from marl_mm.runs.training import Offline
from marl_mm.workers import Executor, open_pool

_DEATHS = 3
"""Deaths of processes that did nothing but a run with which that counts as failed."""

_ALL = "all runs"
"""Label of the bar of the whole plan."""


@dataclass(frozen=True)
class Job:
    """A run to be trained, from where it stands, and to be evaluated."""

    label: str
    seed: int
    run: Path
    dataset: str | Path | Location
    """What it learns from."""

    options: Offline
    """How; with one worker."""

    probes: Sequence[Probe]
    seconds: float = 1.0
    """How long it takes, about."""

    @property
    def done(self) -> bool:
        """Whether nothing of it is missing."""
        return all(map(self.has, self.probes))

    def has(self, probe: Probe) -> bool:
        """Whether it has been evaluated so."""
        options = self.options
        return is_probed(self.run, probe, options.eval_episodes, options.overrides)


Complaint = str
"""Why a run has failed; empty if it has not."""


def do_jobs(
    jobs: Iterable[Job],
    workers: int,
    executor: Executor,
    done: Callable[[Job], None],
) -> dict[Path, Complaint]:
    """Do jobs, whatever becomes of some of them.

    When a process dies, the runs that may have been under way are then done one at a
    time, so that it shows which of them kills processes.

    Args:
        jobs: What is to be done.
        workers: Processes.
        executor: Of which machines; these share one file system.
        done: Called in this process after each that succeeded; a ``MarlMmError`` makes
            it one that failed.

    Returns:
        Runs that failed, and why.

    Raises:
        KeyboardInterrupt: After Ctrl-C; runs go on from their last checkpoints.
    """
    left = {job.run: job for job in jobs}
    failed: dict[Path, Complaint] = {}
    begun, total = monotonic(), sum(job.seconds for job in left.values())
    context = get_context("forkserver")
    messages, stop = context.Queue(), context.Event()
    deaths = dict.fromkeys(left, 0)
    suspects: list[Path] = []
    with progress_bars(vanish=True) as bar, show_distant_bars(messages, bar):
        messages.put((_ALL, len(left), 0, ""))
        while left:
            shared = (messages, stop) if executor == "local" else (None, None)
            under_way = suspects[:1] or list(left)
            # Of two processes that have one run only one begins; 1 would be this one.
            processes = min(workers, max(len(under_way), 2))
            pool = open_pool(executor, processes, _begin, shared)
            try:
                asked = [left[run] for run in under_way]
                for run, complaint in pool.completed(_do, asked):
                    complaint = complaint or _settled(left[run], done)
                    del left[run]
                    if complaint:
                        failed[run] = complaint
                    rest = sum(job.seconds for job in left.values())
                    note = _remaining(monotonic() - begun, rest, total)
                    messages.put((_ALL, 0, 1, note))
            except WorkerDiedError as error:
                if suspects:
                    deaths[suspects[0]] += 1
                    if deaths[suspects[0]] == _DEATHS:
                        failed[suspects[0]] = str(error)
                        del left[suspects[0]]
                else:  # no more are handed out at once
                    suspects = [run for run in under_way if run in left][: 2 * workers]
                told = f"{error}; going on with {len(left)} runs"
                print(told, file=sys.stderr)
            except BaseException:
                stop.set()
                raise
            finally:
                pool.close()
            suspects = [run for run in suspects if run in left]
    return failed


def _settled(job: Job, done: Callable[[Job], None]) -> Complaint:
    """What stands in the way of a run's rows, if anything does."""
    try:
        done(job)
    except MarlMmError as error:
        return str(error)
    return ""


def _remaining(spent: float, rest: float, total: float) -> str:
    """How long the rest will take, if all goes on as it went."""
    hours = spent * rest / max(total - rest, 1e-9) / 3600
    return f"about {hours:.1f} h left" if rest else ""


_bar: Bar


def _begin(messages: Any, stop: Any) -> None:
    """A process's first act."""
    global _bar
    if messages is None:
        _bar = silent_bar
    else:
        messages.cancel_join_thread()  # another, killed, may never let go of it
        _bar = distant_bars(messages, stop)


def _do(job: Job) -> tuple[Path, Complaint]:
    """The job, or why it failed."""
    try:
        dataset = load_dataset(job.dataset)
        if not job.has(LAST):
            _train(dataset, job)
        for probe in job.probes:
            if not job.has(probe):
                _probe(dataset, job, probe)
    except MarlMmError as error:
        return job.run, str(error)
    except Exception as error:  # such as torch's, out of memory: others go on
        return job.run, f"{type(error).__name__}: {error}"
    return job.run, ""


def _train(dataset: Dataset, job: Job) -> None:
    try:
        train_offline_run(dataset, job.options, job.seed, job.run, _named(job))
    except DivergedError:
        if not (job.run / checkpoint.FILE).exists():
            raise
        # The last checkpoint counts as it is.
        evaluate_offline_run(dataset, job.options, job.run, _named(job), "eval")


def _probe(dataset: Dataset, job: Job, probe: Probe) -> None:
    """Evaluate a trained run in a way of its own."""
    options = job.options
    file = checkpoint.BEST if probe.checkpoint == "best" else checkpoint.FILE
    policy: Any = load_policy(job.run / file)
    if probe.alpha is not None:
        policy = FixedAlpha(policy, probe.alpha)
    evaluation = evaluate(
        policy,
        options.eval_episodes,
        options.eval_seed,
        task_of(dataset, options),
        {**options.overrides, **probe.overrides},
        advance=_named(job)(probe.name, options.eval_episodes),
    )
    found = {**evaluation.to_json(), "probe": probe_way(probe)}
    write_json(probe_file(job.run, probe), found)


def _named(job: Job) -> Bar:
    """Bars whose labels say which run they are of."""

    def bar(label: str, total: int) -> Advance:
        what = label.split()[0]
        training = what in ALGORITHMS
        return _bar(job.label if training else f"{job.label} {what}", total)

    return bar
