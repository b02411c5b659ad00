"""marl-mm check: contract tests on plug-ins, and files of others."""

import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import asdict
from functools import partial
from pathlib import Path
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
from marl_mm.contracts.files import KINDS, kind_of
from marl_mm.contracts.fuzz import file_claims
from marl_mm.datasets.dataset import existing
from marl_mm.envs.registry import DEFAULT, TASKS
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.metrics import METRICS
from marl_mm.plugins import load
from marl_mm.progress import progress_bar
from marl_mm.registry import Registry
from marl_mm.runs.settings import check_seed


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
    mutations: int = 0,
    seed: int = 0,
    json: bool = False,
) -> None:
    """Check whether plug-ins keep their promises, and files of others are whole.

    Each task, algorithm, collector and metric of a plug-in is put through the package's
    own contract tests, in short: seeds, resuming, several seeds at once, shapes and
    ranges, exports, PettingZoo's and Gymnasium's tests, replays, hindsight, workers,
    NaN. Tasks run on MuJoCo. Files are datasets, runs, checkpoints, exported policies,
    journals of collections, records and rows of results; nothing in them is run. Exit
    code 1 if a claim does not hold.

    Args:
        what: Plug-ins, FILE.py or module, which are run; names of what is registered;
            files, folders or ids of datasets, which are not. A folder with such files
            is never taken for a module.
        task: Task of collectors and metrics.
        mutations: Number of times that a copy of each file is damaged at random, partly
            with its checksums computed anew, and has to be refused, or read without
            harm, within 10 s.
        seed: Seed of the mutations.
        json: Print the findings as JSON.
    """
    if not what:
        raise UsageError("name a plug-in, FILE.py or a module, a file, or a dataset")
    check_seed(seed)
    if mutations < 0:
        raise UsageError(f"`mutations` is {mutations}, expected >= 0")
    subjects = [
        subject for word in what for subject in _subjects(word, task, mutations, seed)
    ]
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


def _subjects(what: str, task: str, mutations: int, seed: int) -> Iterator[Subject]:
    """Registered objects of a plug-in or of a name, or a file of others."""
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
    if not chosen and (path := _file(what)) is not None:
        claims = file_claims(mutations, seed)
        yield Subject(f"{kind_of(path).name} {what}", path, claims)
        return
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


def _file(what: str) -> Path | None:
    """The file, folder or dataset of a name; None if it can only be a plug-in."""
    path = Path(what)
    if path.suffix == ".py":
        return None
    package = (path / "__init__.py").exists() and not any(
        kind.fits(path) for kind in KINDS
    )
    if path.exists():
        return None if package else path
    folder = existing(what).folder
    if not folder.exists() and "/" in what:
        raise UsageError(f"there is no {what}, expected a file, a dataset or a plug-in")
    return folder if folder.exists() else None


def _examined(subject: Subject) -> Iterator[Finding]:
    findings = examine(*subject)
    while True:
        with redirect_stdout(sys.stderr):  # PettingZoo's tests say that they pass
            finding = next(findings, None)
        if finding is None:
            return
        yield finding


def _line(finding: Finding) -> str:
    verdict = "fails" if finding.broken else "holds"
    why = f": {finding.broken}" if finding.broken else ""
    return f"{verdict}  {finding.subject}: {finding.claim}{why}"
