"""marl-mm check: the package's own contract tests, on plug-ins."""

import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import asdict
from functools import partial
from typing import Annotated, Any, NamedTuple

import tyro

from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.commands.options import task_help
from marl_mm.commands.output import show
from marl_mm.commands.parser import command
from marl_mm.contracts import algorithms, collectors, learners, metrics, tasks
from marl_mm.contracts.claims import Claim, Finding, examine
from marl_mm.contracts.episodes import short
from marl_mm.envs.registry import DEFAULT, TASKS
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.metrics import METRICS
from marl_mm.plugins import load
from marl_mm.progress import progress_bar
from marl_mm.registry import Registry


class Subject(NamedTuple):
    """A registered object to check."""

    words: str
    """Kind and name, for messages."""

    about: Any
    """Object that the claims are about."""

    claims: dict[str, Claim]
    """Claims by name."""


@command
def main(
    what: tyro.conf.Positional[tuple[str, ...]],
    *,
    task: Annotated[str, task_help("Task of collectors and metrics: {}.")] = DEFAULT,
    json: bool = False,
) -> None:
    """Check whether plug-ins keep to what the package promises of its own.

    Each of their tasks, algorithms, collectors and metrics is put through the package's
    own contract tests, in short: seeds, resuming, several seeds at once, shapes and
    ranges, exports, PettingZoo's and Gymnasium's tests, replays, hindsight, workers,
    NaN. Exit code 1 if a claim does not hold.

    Args:
        what: Plug-ins, FILE.py or module, or names of what is registered.
        task: Task of collectors and metrics.
        json: Print the findings as JSON.
    """
    if not what:
        raise UsageError("name a plug-in, FILE.py or a module, or what is registered")
    subjects = [subject for word in what for subject in _subjects(word, task)]
    findings = []
    total = sum(len(subject.claims) for subject in subjects)
    with progress_bar("check", total) as advance:
        for subject in subjects:
            for finding in _examined(subject):
                findings.append(finding)
                advance(1, subject.words)
                if not json:
                    print(_line(finding), flush=True)
    if json:
        show([asdict(finding) for finding in findings])
    broken = [finding for finding in findings if finding.broken]
    if broken:
        raise MarlMmError(f"{len(broken)} of {len(findings)} claims do not hold")


def _subjects(what: str, task: str) -> Iterator[Subject]:
    """Registered objects of a plug-in, or of a name."""
    collector, metric = (
        partial(module.candidate, task=task) for module in (collectors, metrics)
    )
    kinds: tuple[tuple[Registry[Any], Any, Any], ...] = (
        (TASKS, short, tasks.task_claims),
        (ALGORITHMS, learners.candidate, algorithms.algorithm_claims),
        (COLLECTORS, collector, collectors.collector_claims),
        (METRICS, metric, metrics.metric_claims),
    )
    chosen = [(*kind, what) for kind in kinds if what in kind[0]]
    if not chosen:
        origin = load(what).name
        chosen = [
            (*kind, name)
            for kind in kinds
            for name in kind[0].names()
            if kind[0].origin(name) == origin
        ]
    if not chosen:
        raise UsageError(f"{what} registers no task, algorithm, collector or metric")
    for registry, make, claims, name in chosen:
        about = make(name)
        yield Subject(f"{registry.kind} {name}", about, claims(about))


def _examined(subject: Subject) -> Iterator[Finding]:
    findings = examine(*subject)
    while True:
        with redirect_stdout(sys.stderr):  # PettingZoo's tests say that they pass
            finding = next(findings, None)
        if finding is None:
            return
        yield finding


def _line(finding: Finding) -> str:
    holds = "broken" if finding.broken else "holds "
    why = f": {finding.broken}" if finding.broken else ""
    return f"{holds} {finding.subject}: {finding.claim}{why}"
