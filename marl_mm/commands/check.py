"""marl-mm check: the package's own contract tests, on plug-ins."""

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from functools import partial
from typing import Annotated, Any, NamedTuple

import tyro

from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.commands.options import REGISTERED
from marl_mm.commands.parser import parse_options
from marl_mm.contracts import algorithms, collectors, learners, metrics, tasks
from marl_mm.contracts.claims import Claim, Finding, examine
from marl_mm.contracts.episodes import short
from marl_mm.envs.registry import DEFAULT, TASKS
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.metrics import METRICS
from marl_mm.plugins import load
from marl_mm.progress import progress_bar
from marl_mm.registry import Registry


@dataclass(frozen=True)
class Check:
    """Check whether plug-ins keep to what the package promises of its own.

    Each of their tasks, algorithms, collectors and metrics is put through the package's
    own contract tests, in short: seeds, resuming, several seeds at once, shapes and
    ranges, exports, PettingZoo's and Gymnasium's tests, replays, hindsight, workers,
    NaN. Exit code 1 if a claim does not hold.
    """

    what: tyro.conf.Positional[tuple[str, ...]]
    """Plug-ins, FILE.py or module, or names of what is registered."""

    task: Annotated[
        str,
        tyro.conf.arg(help=f"Task of collectors and metrics: {REGISTERED}."),
    ] = DEFAULT

    json: bool = False
    """Print the findings as JSON."""


class Subject(NamedTuple):
    """A registered object to check."""

    words: str
    """Kind and name, for messages."""

    about: Any
    """Object that the claims are about."""

    claims: dict[str, Claim]
    """Claims by name."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm check``."""
    options = parse_options(Check, "marl-mm check", arguments)
    if not options.what:
        raise UsageError("name a plug-in, FILE.py or a module, or what is registered")
    subjects = [
        subject for what in options.what for subject in _subjects(what, options.task)
    ]
    findings = []
    total = sum(len(subject.claims) for subject in subjects)
    with progress_bar("check", total) as advance:
        for subject in subjects:
            for finding in _examined(subject):
                findings.append(finding)
                advance(1, subject.words)
                if not options.json:
                    print(_line(finding), flush=True)
    if options.json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    broken = [finding for finding in findings if finding.broken]
    if broken:
        raise MarlMmError(f"{len(broken)} of {len(findings)} claims do not hold")


def _subjects(what: str, task: str) -> Iterator[Subject]:
    """Registered objects of a plug-in, or of a name."""
    kinds: tuple[tuple[Registry[Any], Any, Any], ...] = (
        (TASKS, short, tasks.task_claims),
        (ALGORITHMS, learners.candidate, algorithms.algorithm_claims),
        (
            COLLECTORS,
            partial(collectors.candidate, task=task),
            collectors.collector_claims,
        ),
        (METRICS, partial(metrics.candidate, task=task), metrics.metric_claims),
    )
    known = [kind for kind in kinds if what in kind[0]]
    chosen = [(*kind, what) for kind in known]
    if not known:
        origin = load(what).name
        chosen = [
            (*kind, name)
            for kind in kinds
            for name in kind[0].names()
            if kind[0].origin(name) == origin
        ]
        if not chosen:
            raise UsageError(
                f"{what} registers no task, algorithm, collector or metric"
            )
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
