"""marl-mm ablate: tables and figures of the paper, and ours, from raw runs."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from marl_mm.commands.output import show
from marl_mm.commands.parser import Subcommand, parse_subcommand
from marl_mm.commands.wording import as_options
from marl_mm.errors import UsageError
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import to_json
from marl_mm.eval.studies.benchmark import BenchmarkOptions
from marl_mm.eval.studies.checks import Check, checks_of, states_of
from marl_mm.eval.studies.coordination import CoordinationOptions
from marl_mm.eval.studies.engines import EnginesOptions
from marl_mm.eval.studies.make import make_tables, runs_of
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.robustness import RobustnessOptions
from marl_mm.eval.studies.runner import StudyRunner
from marl_mm.eval.studies.study import Study
from marl_mm.eval.studies.targets import (
    COMPARISONS,
    GROUPS,
    STUDIES,
    Comparison,
    Comparisons,
    part_of,
    study_of,
)
from marl_mm.eval.studies.tuning import TuningOptions
from marl_mm.files import refuse_existing
from marl_mm.progress import progress_bars
from marl_mm.workers import available_cores

_OF_FILE = ".py:"


@dataclass(frozen=True, kw_only=True)
class Ablate(StudyOptions):
    """Make tables and figures, training the runs that are missing."""

    datasets: tuple[str, ...] | None = None
    """Names of the datasets to run, default all; missing ones are collected first."""

    settings: tuple[str, ...] | None = None
    """Names of the settings to run; default all of the study. With some datasets or
    settings only, a study's files are called NAME-part."""

    workers: int = field(default_factory=available_cores)
    """Runs at once; the result does not depend on their number."""

    plan: bool = False
    """Only print which runs are missing, for engines which policies, and about how long
    they will take. Missing datasets are named; collecting them is not counted."""

    check: bool = False
    """Only say whether tables in OUT, in a clone by default the committed ones, are
    what their rows give, to the byte."""

    json: bool = False
    """Print the tables as JSON."""


@dataclass(frozen=True, kw_only=True)
class AblateEngines(Ablate, EnginesOptions):
    """Compare the engines, running the policies that are missing."""


@dataclass(frozen=True, kw_only=True)
class AblateCoordination(Ablate, CoordinationOptions):
    """Compare teams, running those that are missing."""


@dataclass(frozen=True, kw_only=True)
class AblateRobustness(Ablate, RobustnessOptions):
    """Compare teams with joint actors, running those that are missing."""


@dataclass(frozen=True, kw_only=True)
class AblateBenchmark(Ablate, BenchmarkOptions):
    """Compare algorithms, training the runs that are missing."""


@dataclass(frozen=True, kw_only=True)
class AblateTuning(Ablate, TuningOptions):
    """Try settings of algorithms, running those that are missing."""


_OPTIONS = {
    "engines": AblateEngines(),
    "coordination": AblateCoordination(),
    "robustness": AblateRobustness(),
    "tuning": AblateTuning(),
    "benchmark": AblateBenchmark(),
}
"""Options of targets that have others than all have."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm ablate``."""
    target, options, studies, comparisons = _parsed(arguments)
    given = {"datasets": options.datasets, "settings": options.settings}
    part = {name: names for name, names in given.items() if names is not None}
    if isinstance(options, BenchmarkOptions):
        comparisons = {target: replace(comparisons[target], study=options.study)}
    if options.check:
        if part or options.plan:
            beside = "--datasets, --settings, --plan"
            raise UsageError(f"--check is for whole tables, without {beside}")
        print_states(checks_of(options, studies, comparisons), options.json)
        return
    if part:
        studies, comparisons = part_of(target, studies, comparisons, part)
    with progress_bars(vanish=True) as bar:
        runner = StudyRunner(options, _notify, bar)
        if options.plan:
            counted = studies | runs_of(comparisons)
            plans = [runner.plan(counted)] if counted else []
            plans += [c.plan(options, bar) for c in comparisons.values() if c.plan]
            print("\n".join(plans), end="")
            return
        again = options.overwrite or options.resume
        for comparison in comparisons.values():
            refuse_existing(options.results / comparison.file, again)
        tables: dict[str, list[Row]] = {}
        try:
            for name, rows, text in make_tables(runner, studies, comparisons):
                tables[name] = rows
                if not options.json:
                    print(text)
        finally:
            if options.json and tables:
                print(to_json(tables))


def print_states(checks: Sequence[Check], as_json: bool) -> None:
    """Print of every table whether it is what its rows give, as JSON by its path."""
    states: dict[str, str] = {}
    try:
        for path, state in states_of(checks):
            states[str(path)] = state
            if not as_json:
                print(f"{path}: {state}")
    finally:  # also if a table is not the same
        if as_json:
            show(states)


def _parsed(
    arguments: Sequence[str],
) -> tuple[str, Ablate, dict[str, Study], Comparisons]:
    """The target, the options, and what studies and comparisons the target is.

    To check all is to check the others, too.
    """
    word = arguments[0] if arguments else ""
    if word.endswith(".py"):
        raise UsageError(f"name a study of the file, such as {word}:STUDY")
    every: dict[str, Study | Comparison] = {**STUDIES, **COMPARISONS}
    abouts = {name: thing.about for name, thing in every.items()} | {
        "paper": "The paper's own: Tables 4 and 5, Figs. 4, 5 and 7 to 10, in a night.",
        "all": "Every table and figure of the paper's tasks, on one engine.",
    }
    if _OF_FILE in word:
        abouts[word] = "A study of your own."
    target, options = parse_subcommand(
        {
            name: Subcommand(_OPTIONS.get(name, Ablate()), about)
            for name, about in abouts.items()
        },
        "marl-mm ablate",
        "Reproduce figures and tables, training the runs they need. FILE.py:NAME is a "
        "study of your own, an object NAME of class marl_mm.Study.",
        arguments,
    )
    if _OF_FILE in target:
        path, _, name = target.partition(_OF_FILE)
        return target, options, {name.lower(): study_of(Path(f"{path}.py"), name)}, {}
    names = GROUPS.get(target, (target,))
    names = tuple(every) if options.check and target == "all" else names
    studies = {name: STUDIES[name] for name in names if name in STUDIES}
    comparisons = {name: COMPARISONS[name] for name in names if name in COMPARISONS}
    return target, options, studies, comparisons


def _notify(text: str) -> None:
    print(as_options(text), file=sys.stderr)
