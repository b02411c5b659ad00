"""Whether tables are what their rows give."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import marl_mm
from marl_mm.errors import FailedRunsError, MarlMmError, UsageError
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.runner import StudyRunner
from marl_mm.eval.studies.study import Study
from marl_mm.eval.studies.sweep import draw_sweep
from marl_mm.eval.studies.targets import STUDIES, Comparisons
from marl_mm.received import damage_named

_COMMITTED = Path(marl_mm.__file__).parent / "eval" / "results"
"""Folder of the committed results, in a clone."""

Check = tuple[Path, Callable[[Path], object]]
"""A folder of tables, and what draws them into another folder."""


def checks_of(
    options: StudyOptions, studies: Mapping[str, Study], comparisons: Comparisons
) -> list[Check]:
    """Checks of the existing tables: the committed ones where no others are named.

    Raises:
        UsageError: If there are no tables.
    """
    moved = options.out or options.runs or options.engine
    ours = all(STUDIES.get(name) is study for name, study in studies.items())
    committed = ours and not (moved or options.small)
    if committed and _COMMITTED.exists():
        options = replace(options, out=_COMMITTED / "studies")
    results, runner = options.results, StudyRunner(options)
    checks: list[Check] = [
        (results, partial(runner.draw, name, study))
        for name, study in studies.items()
        if len(studies) == 1 or (results / f"{name}.csv").exists()
    ]
    checks += [
        (results, partial(comparison.draw, results))
        for comparison in comparisons.values()
        if not studies or (results / comparison.file).exists()
    ]
    swept = _COMMITTED / "alpha"
    if committed and len(studies) == len(STUDIES) and swept.exists():
        checks.append((swept, partial(draw_sweep, swept)))
    if not checks:
        raise UsageError(f"{results} has no tables to check: name theirs with `out`")
    return checks


def states_of(checks: Sequence[Check]) -> Iterator[tuple[Path, str]]:
    """Each table, and whether it is what its rows give; see ``compared_tables``.

    Raises:
        MarlMmError: After the last one, if one is not the same.
    """
    failures: list[MarlMmError] = []
    for folder, draw in checks:
        try:
            for path, state in compared_tables(folder, draw).items():
                yield path, state
                if state != "the same":
                    why = "not what the rows there give; draw again with --overwrite"
                    failures.append(MarlMmError(f"{path}: {why}"))
        except MarlMmError as error:
            failures.append(error)
    raise_together(failures)


def compared_tables(results: Path, draw: Callable[[Path], object]) -> dict[Path, str]:
    """Whether tables are what is drawn now: ``the same``, ``another`` or ``missing``.

    Figures are drawn again at will, and not compared.

    Args:
        results: Folder of the tables.
        draw: Draws them into another folder, from the rows in ``results``.

    Raises:
        UsageError: If rows are missing.
    """
    with TemporaryDirectory() as folder:
        with damage_named(f"{results}, rows", MarlMmError):
            draw(Path(folder))
        states = {}
        for drawn in sorted(Path(folder).glob("*.csv")):
            table = results / drawn.name
            states[table] = "missing"
            if table.exists():
                same = table.read_bytes() == drawn.read_bytes()
                states[table] = "the same" if same else "another"
    return states


def raise_together(failures: Sequence[MarlMmError]) -> None:
    """Raise the failure, or one that names several; nothing without any."""
    if len(failures) == 1:
        raise failures[0]
    if failures:
        raise FailedRunsError("; ".join(map(str, failures)))
