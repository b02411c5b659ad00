"""Makes tables of studies and comparisons, as many as can be had."""

from collections.abc import Iterator, Mapping

from marl_mm.errors import FailedRunsError, MarlMmError
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies.checks import raise_together
from marl_mm.eval.studies.runner import StudyRunner
from marl_mm.eval.studies.study import Study
from marl_mm.eval.studies.targets import Comparisons


def make_tables(
    runner: StudyRunner, studies: Mapping[str, Study], comparisons: Comparisons
) -> Iterator[tuple[str, list[Row], str]]:
    """Make what is missing, and draw what there is; failures stop no others.

    Yields:
        Name, rows and Markdown of each table.

    Raises:
        FailedRunsError: At the end, if runs failed. Comparisons are drawn of the
            others.
    """
    failures: list[MarlMmError] = []
    try:
        for name, table in runner.run(studies):
            yield name, table.rows, f"{table.study.about}\n\n{table.markdown()}"
    except FailedRunsError as error:
        failures.append(error)
    for name, comparison in comparisons.items():
        failed = len(failures)
        try:
            runner.make_rows(runs_of({name: comparison}))
        except FailedRunsError as error:
            failures.append(error)
        try:
            rows = comparison.make(runner.options, runner.bar)
            yield name, rows, f"{comparison.about}\n\n{comparison.markdown(rows)}"
        except MarlMmError as error:  # there may be none of the others
            if len(failures) == failed and not isinstance(error, FailedRunsError):
                failures.append(error)
                break
            failures.append(error)
    raise_together(failures)


def runs_of(comparisons: Comparisons) -> dict[str, Study]:
    """Studies whose runs are compared."""
    return {name: c.study for name, c in comparisons.items() if c.study is not None}
