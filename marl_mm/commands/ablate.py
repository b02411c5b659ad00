"""marl-mm ablate: tables and figures of the paper, and ours, from raw runs.

Runs that a target needs and that are not there are trained first; finished ones are
kept, interrupted ones go on.
"""

import runpy
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from marl_mm.commands.options import COMMITTED
from marl_mm.commands.parser import Subcommand, parse_options, parse_subcommand
from marl_mm.errors import FailedRunsError, MarlMmError, UsageError
from marl_mm.eval.rows import to_json
from marl_mm.eval.studies.engine import compare, draw, plan_studies, run_studies
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.study import Study
from marl_mm.eval.studies.sweep import draw_sweep
from marl_mm.eval.studies.targets import (
    EXTRAS,
    GROUPS,
    STUDIES,
    draw_worth,
    make_extra,
)
from marl_mm.progress import progress_bars
from marl_mm.workers import available_cores

_OF_FILE = ".py:"


@dataclass(frozen=True, kw_only=True)
class Ablate(StudyOptions):
    """Make tables and figures, training the runs that are missing."""

    datasets: tuple[str, ...] | None = None
    """Those named; default all of the study. What is missing of ours is collected
    first."""

    settings: tuple[str, ...] | None = None
    """Those named; default all of the study. Of some datasets or settings, files are
    called NAME-part."""

    workers: int = field(default_factory=available_cores)
    """Runs at once; the result does not depend on their number."""

    plan: bool = False
    """Only print which runs are missing, and about how long they will take. Datasets
    that are missing, too, are named; to collect them is not counted."""

    check: bool = False
    """Only say whether tables in OUT, in a clone by default the committed ones, are
    what their rows give, to the byte."""

    json: bool = False
    """Print the tables as JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm ablate``."""
    if arguments and _OF_FILE in arguments[0]:
        path, _, target = arguments[0].partition(_OF_FILE)
        options = parse_options(Ablate, "marl-mm ablate", arguments[1:])
        studies = {target.lower(): _declared(Path(f"{path}.py"), target)}
        extras: Sequence[str] = ()
    else:
        target, options = _parsed(arguments)
        names = GROUPS.get(target, (target,))
        studies = {name: STUDIES[name] for name in names if name in STUDIES}
        extras = [name for name in names if name in EXTRAS]
    if options.datasets is not None or options.settings is not None:
        studies = _parts(studies, options, target)
    if options.check:
        check_tables(_checks(options, studies, extras))
        return
    with progress_bars(vanish=True) as bar:
        if options.plan:
            needed = {n: one for n in extras if (one := EXTRAS[n].study) is not None}
            print(plan_studies(studies | needed, options, _tell, bar), end="")
            return
        failures: list[MarlMmError] = []
        tables = {}
        try:
            for name, table in run_studies(studies, options, _tell, bar):
                tables[name] = table.rows
                if not options.json:
                    print(f"{table.study.about}\n\n{table.markdown()}")
        except FailedRunsError as error:
            failures.append(error)
        for name in extras:
            try:
                text = make_extra(name, options, _tell, bar)
            except FailedRunsError as error:
                failures.append(error)
            else:
                print(text, file=sys.stderr if options.json else sys.stdout)
    if options.json:
        print(to_json(tables))
    _raise(failures)


def _parsed(arguments: Sequence[str]) -> tuple[str, Ablate]:
    abouts = {name: one.about for name, one in (STUDIES | EXTRAS).items()} | {
        "paper": "The paper's own: Tables 4 and 5 and Figs. 4 to 10, in one night.",
        "all": "Every table and figure.",
    }
    commands = {name: Subcommand(Ablate(), about) for name, about in abouts.items()}
    about = (
        "Reproduce figures and tables, training the runs they need. FILE.py:NAME is a "
        "study of your own, an object NAME of class marl_mm.Study."
    )
    return parse_subcommand(commands, "marl-mm ablate", about, arguments)


def _tell(text: str) -> None:
    print(text.replace("`resume=True`", "--resume"), file=sys.stderr)


def _declared(path: Path, name: str) -> Study:
    """A study from somebody's own file.

    Raises:
        UsageError: If there is none of that name.
    """
    if not path.is_file():
        raise UsageError(f"there is no file {path}, expected FILE.py:NAME")
    sys.path.insert(0, str(path.parent))  # of what it imports itself
    try:
        found = runpy.run_path(str(path))
    except MarlMmError as error:
        raise UsageError(f"{path}: {error}") from error
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise UsageError(f"{path} cannot be run: {reason:.300}") from error
    finally:
        sys.path.remove(str(path.parent))
    study = found.get(name)
    if isinstance(study, Study):
        return study
    known = [key for key, value in found.items() if isinstance(value, Study)]
    raise UsageError(
        f"{path} has no Study called {name!r}, expected one of "
        f"{', '.join(known) or 'its names: it has none'}"
    )


def _parts(
    studies: Mapping[str, Study], options: Ablate, target: str
) -> dict[str, Study]:
    """The asked part of a study.

    Raises:
        UsageError: If the target is none, or is several.
    """
    if len(studies) != 1:
        raise UsageError(f"--settings and --datasets are for a study, not for {target}")
    ((name, study),) = studies.items()
    part = study.part(options.datasets, options.settings)
    if len(part.cells) == len(study.cells):
        return {name: study}
    if options.check:
        raise UsageError("--check is for whole tables, without --datasets, --settings")
    return {f"{name}-part": part}


def check_tables(checks: Sequence[tuple[Path, Callable[[Path], object]]]) -> None:
    """Print of every table whether it is what its rows give.

    Args:
        checks: Folders of tables, and what draws them into another folder.

    Raises:
        MarlMmError: If one is not; failures do not stop the others.
    """
    failures: list[MarlMmError] = []
    for folder, again in checks:
        try:
            states = compare(folder, again)
        except MarlMmError as error:
            failures.append(error)
            continue
        for path, state in states.items():
            print(f"{path}: {state}")
        wrong = [str(path) for path, state in states.items() if state != "the same"]
        if wrong:
            text = f"{', '.join(wrong)}: not what the rows there give; draw again with "
            failures.append(MarlMmError(f"{text}--overwrite"))
    _raise(failures)


def _checks(
    options: Ablate, studies: Mapping[str, Study], extras: Sequence[str]
) -> list[tuple[Path, Callable[[Path], object]]]:
    """Folders of the tables that there are, and what draws them into another folder.

    Raises:
        UsageError: If the target has no table.
    """
    committed = not (options.out or options.runs or options.small)
    if committed and COMMITTED.exists():
        options = replace(options, out=COMMITTED / "studies")
    results = options.results
    checks: list[tuple[Path, Callable[[Path], object]]] = [
        (results, partial(draw, name, study, options))
        for name, study in studies.items()
        if len(studies) == 1 or (results / f"{name}.csv").exists()
    ]
    if "alpha" in extras:
        checks.append((results, partial(draw_worth, results)))
    swept = COMMITTED / "alpha"
    if committed and len(studies) == len(STUDIES) and swept.exists():
        checks.append((swept, partial(draw_sweep, swept)))
    if not checks:
        raise UsageError(f"--check is for tables, and {' '.join(extras)} has none")
    return checks


def _raise(failures: Sequence[MarlMmError]) -> None:
    if len(failures) == 1:
        raise failures[0]
    if failures:
        raise FailedRunsError("; ".join(map(str, failures)))
