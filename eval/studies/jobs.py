"""Runs of studies, each trained and evaluated by one of several processes."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from time import monotonic
from typing import Any

from marl_mm.algorithms import checkpoint
from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.envs.registry import merged
from marl_mm.errors import MarlMmError, WorkerDiedError
from marl_mm.eval.evaluate import evaluate
from marl_mm.eval.studies.held import FixedAlpha
from marl_mm.eval.studies.learners import Learner
from marl_mm.eval.studies.run_rows import is_probed
from marl_mm.eval.studies.settings import Probe
from marl_mm.eval.studies.study import Cell, cell_name
from marl_mm.files import write_json
from marl_mm.progress import Advance, Bar, distant_bars, show_distant_bars, silent_bar
from marl_mm.runs.making import Notify
from marl_mm.workers import Executor, open_pool

_DEATHS = 3
"""Number of processes that a run may kill while nothing else runs in them; then it
fails for good."""

_ALL = "all runs"
"""Label of the bar of the whole plan."""


@dataclass(frozen=True)
class Job:
    """A run to train, from its last checkpoint, and to evaluate."""

    cell: Cell
    """Source and setting."""

    seed: int
    """Seed of the run."""

    run: Path
    """Folder of the run."""

    learner: Learner
    """Learner that trains the run."""

    probes: tuple[Probe, ...]
    """Evaluations of the run."""

    seconds: float = 1.0
    """Estimated remaining time [s]."""

    def label_of(self, seeds: Sequence[str]) -> str:
        """Label of a progress bar of runs of the cell; without seeds, of this one."""
        source, setting = cell_name(self.cell)
        short = "-".join(source.removeprefix("marl_mm/").split("-")[:2])
        return f"{setting} {' '.join(seeds) or self.seed} {short}"

    @property
    def done(self) -> bool:
        """Whether the run is trained and has all its evaluations."""
        return self.trained and all(map(self.has, self.probes))

    @property
    def trained(self) -> bool:
        """Whether the run has the evaluations that a training ends with."""
        return all(map(self.has, self.learner.probes))

    def has(self, probe: Probe) -> bool:
        """Whether the run has this evaluation."""
        training = self.learner.training
        return is_probed(self.run, probe, training.eval_episodes, training.overrides)


Complaint = str
"""Why a run has failed; empty if it has not."""


def do_jobs(
    jobs: Iterable[Job],
    workers: int,
    executor: Executor,
    done: Callable[[Job], None],
    notify: Notify,
    bar: Bar,
) -> dict[Path, Complaint]:
    """Do jobs; one that fails does not stop the others.

    On a GPU those of a cell are done in one process, side by side. When a process dies,
    those that may have been under way are then done one at a time, so that it shows
    which of them kills processes.

    Args:
        jobs: Runs to train and evaluate.
        workers: Number of processes.
        executor: Processes of this machine, or of a Ray cluster that shares its files.
        done: Callback in this process after each job that succeeded; with a
            ``MarlMmError`` it counts as failed.
        notify: Callback for messages to the user, such as that a process died.
        bar: Factory of progress bars, called in a thread.

    Returns:
        Folders of the runs that failed, and why.

    Raises:
        KeyboardInterrupt: After Ctrl-C; runs go on from their last checkpoints.
    """
    left = {group[0].run: group for group in _by_process(jobs)}
    failed: dict[Path, Complaint] = {}
    begun, total = monotonic(), _seconds(left.values())
    context = get_context("forkserver")
    messages, stop = context.Queue(), context.Event()
    deaths = dict.fromkeys(left, 0)
    suspects: list[Path] = []
    with show_distant_bars(messages, stop, bar):
        messages.put((_ALL, sum(map(len, left.values())), 0, ""))
        while left:
            shared = (messages, stop) if executor == "local" else (None, None)
            under_way = suspects[:1] or list(left)
            # Of two processes that have one run only one begins; 1 would be this one.
            processes = min(workers, max(len(under_way), 2))
            pool = open_pool(executor, processes, _begin, shared)
            try:
                asked = [left[run] for run in under_way]
                for run, complaints in pool.completed(_do, asked):
                    group = left.pop(run)
                    for job, complaint in zip(group, complaints, strict=True):
                        if why := complaint or _settled(job, done):
                            failed[job.run] = why
                    rest = _seconds(left.values())
                    note = _remaining(monotonic() - begun, rest, total)
                    messages.put((_ALL, 0, len(group), note))
            except WorkerDiedError as error:
                if suspects:
                    deaths[suspects[0]] += 1
                    if deaths[suspects[0]] == _DEATHS:
                        for job in left.pop(suspects[0]):
                            failed[job.run] = str(error)
                else:  # no more are handed out at once
                    suspects = [run for run in under_way if run in left][: 2 * workers]
                runs = sum(map(len, left.values()))
                notify(f"{error}; going on with {runs} runs")
            except BaseException:
                stop.set()
                raise
            finally:
                pool.close()
            suspects = [run for run in suspects if run in left]
    return failed


def _by_process(jobs: Iterable[Job]) -> Iterable[Sequence[Job]]:
    """Jobs by the process that does them: one, or those that learn side by side."""
    groups: dict[object, list[Job]] = {}
    for job in jobs:
        together = job.learner.training.side_by_side
        key = cell_name(job.cell) if together else job.run
        groups.setdefault(key, []).append(job)
    return groups.values()


def _seconds(groups: Iterable[Sequence[Job]]) -> float:
    return sum(job.seconds for group in groups for job in group)


def _settled(job: Job, done: Callable[[Job], None]) -> Complaint:
    """Why a finished run's rows cannot be kept; empty if they can."""
    try:
        done(job)
    except MarlMmError as error:
        return str(error)
    return ""


def _remaining(spent: float, rest: float, total: float) -> str:
    """Estimated remaining time in words, from the speed so far."""
    hours = spent * rest / max(total - rest, 1e-9) / 3600
    return f"about {hours:.1f} h left" if rest else ""


_bar: Bar


def _begin(messages: Any, stop: Any) -> None:
    """Initialise a process."""
    global _bar
    if messages is None:
        _bar = silent_bar
    else:
        messages.cancel_join_thread()  # another, killed, may never let go of it
        _bar = distant_bars(messages, stop)


def _do(group: Sequence[Job]) -> tuple[Path, list[Complaint]]:
    """Do jobs of one learner; the first one's run, and why each failed."""
    first, why = group[0], ""
    if left := {job.seed: job.run for job in group if not job.trained}:
        why = _complaint(lambda: first.learner.train(left, _named(first)))
    return first.run, [
        why if why and not job.trained else _complaint(partial(_evaluate, job))
        for job in group
    ]


def _complaint(work: Callable[[], None]) -> Complaint:
    """Why work failed; empty if it did not."""
    try:
        work()
    except MarlMmError as error:
        return str(error)
    except Exception as error:  # such as torch's, out of memory: others go on
        return f"{type(error).__name__}: {error}"
    return ""


def _evaluate(job: Job) -> None:
    for probe in job.probes:
        if not job.has(probe):
            _probe(job, probe)


def _probe(job: Job, probe: Probe) -> None:
    """Evaluate a trained run as a probe says."""
    training = job.learner.training
    file = checkpoint.BEST if probe.checkpoint == "best" else checkpoint.FILE
    policy: Any = load_policy(job.run / file)
    if probe.alpha is not None:
        policy = FixedAlpha(policy, probe.alpha)
    evaluation = evaluate(
        policy,
        training.eval_episodes,
        training.eval_seed,
        probe.task or job.learner.task,
        merged(training.overrides, probe.overrides),
        advance=_named(job)(probe.name, training.eval_episodes),
    )
    write_json(probe.file(job.run), {**evaluation.to_json(), "probe": probe.way})


def _named(job: Job) -> Bar:
    """Bars whose labels say which runs they are of: a job's, or others it names."""

    def bar(label: str, total: int) -> Advance:
        what, *rest = label.split()
        seeds = [word for word in rest if word.isdigit()]
        ending = [] if what in ALGORITHMS else [what]
        ending += [word for word in rest if not word.isdigit()]
        return _bar(" ".join([job.label_of(seeds), *ending]), total)

    return bar
