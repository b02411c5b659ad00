"""Runs studies: what is missing is trained, its rows are kept, and tables are drawn."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from marl_mm.errors import FailedRunsError
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies.data import Datasets, Tell
from marl_mm.eval.studies.jobs import Complaint, Job, do_jobs
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.plan import (
    Wanted,
    estimated,
    hours,
    missing_cells,
    plan_table,
)
from marl_mm.eval.studies.study import Curves, Study, cell_name
from marl_mm.eval.studies.summary import summarize
from marl_mm.eval.studies.table import Table
from marl_mm.files import refuse_existing
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.settings import check_positive, check_seeds


def run_studies(
    studies: Mapping[str, Study],
    options: StudyOptions,
    tell: Tell = lambda text: None,
    bar: Bar = silent_bar,
) -> Iterator[tuple[str, Table]]:
    """Make what is missing of some studies, and draw them.

    Args:
        studies: Studies by the name of their files.
        options: How studies are run.
        tell: Told what a reader should know while it happens.
        bar: Begins a bar of progress; it is called in a thread.

    Yields:
        Names and tables that are drawn.

    Raises:
        UsageError: If a table exists, or a dataset is not there.
        OtherConfigError: If rows or runs there were made with something else.
        FailedRunsError: At the end; what could be drawn has been.
        KeyboardInterrupt: After Ctrl-C, saying how to go on.
    """
    for name, study in studies.items():
        for end in (".csv", ".png")[: 1 + bool(study.figure)]:
            again = options.overwrite or options.resume
            refuse_existing(options.results / f"{name}{end}", again)
    wanted, failed = make_rows(studies, options, tell, bar)
    incomplete = {cell_name(one.cell) for one in wanted if failed.keys() & one.runs}
    drawn = []
    for name, study in studies.items():
        if incomplete.isdisjoint(map(cell_name, study.cells)):
            yield name, draw(name, study, options, options.results)
            drawn.append(name)
    if failed:
        reasons = "; ".join(f"{run}: {why}" for run, why in failed.items())
        total = sum(len(one.jobs) for one in wanted)
        raise FailedRunsError(
            f"{len(failed)} of {total} runs failed, the same with `resume=True` tries "
            f"them again; drawn: {', '.join(drawn) or 'nothing'}; {reasons}"
        )


def plan_studies(
    studies: Mapping[str, Study], options: StudyOptions, tell: Tell, bar: Bar
) -> str:
    """What is missing of some studies, and about how long it will take, as Markdown.

    Args:
        studies: Studies by name.
        options: How studies are run.
        tell: Told which datasets are missing.
        bar: Begins a bar of progress.

    Raises:
        OtherConfigError: If rows there were made with something else.
    """
    _check_options(options)
    datasets = _datasets(options, tell, bar)
    wanted = missing_cells(options, studies.values(), datasets, plan=True)
    measured = not options.small
    if measured:
        wanted = estimated(wanted, bar)
    return plan_table(wanted, options.workers, measured)


def draw(name: str, study: Study, options: StudyOptions, folder: Path) -> Table:
    """Write a study's table, and its figure if it has one, from its rows.

    Args:
        name: Name of the files.
        study: The study.
        options: Where its rows are, and which seeds count.
        folder: Folder of the files.

    Raises:
        UsageError: If rows are missing.
    """
    store, seeds = options.store, options.seeds_of(study)
    rows = summarize(study, store, seeds)
    write_csv(folder / f"{name}.csv", rows)
    figure = None
    if study.figure:
        from marl_mm.eval.studies.figures import curves_figure  # imports matplotlib

        curves = study.figure if isinstance(study.figure, Curves) else Curves()
        figure = folder / f"{name}.png"
        curves_figure(study, curves, store, seeds, figure)
    return Table(study, rows, figure)


def compare(results: Path, draw: Callable[[Path], object]) -> dict[Path, str]:
    """Whether tables are what is drawn now: ``the same``, ``another`` or ``missing``.

    Figures are drawn again at will, and not compared.

    Args:
        results: Folder of the tables.
        draw: Draws them into another folder, from the rows in ``results``.

    Raises:
        UsageError: If rows are missing.
    """
    with TemporaryDirectory() as folder:
        draw(Path(folder))
        states = {}
        for drawn in sorted(Path(folder).glob("*.csv")):
            known = results / drawn.name
            states[known] = "missing"
            if known.exists():
                same = known.read_bytes() == drawn.read_bytes()
                states[known] = "the same" if same else "another"
    return states


def make_rows(
    studies: Mapping[str, Study], options: StudyOptions, tell: Tell, bar: Bar
) -> tuple[Sequence[Wanted], dict[Path, Complaint]]:
    """Do what is missing; a cell's rows are kept as soon as all its runs are done.

    Returns:
        Cells that lacked rows, and runs that failed with the reason.

    Raises:
        KeyboardInterrupt: After Ctrl-C, saying how to go on.
    """
    _check_options(options)
    datasets = _datasets(options, tell, bar)
    wanted: Sequence[Wanted] = missing_cells(options, studies.values(), datasets)
    cell_of = {job.run: one for one in wanted for job in one.jobs}

    def keep_if_done(one: Wanted) -> None:
        if all(job.done for job in one.jobs):
            runs = {job.seed: job.run for job in one.jobs}
            options.store.keep(one.cell, runs, one.probes)

    for one in wanted:
        keep_if_done(one)
    left = [job for one in wanted for job in one.jobs if not job.done]
    if not left:
        return wanted, {}
    text = f"{len(left)} of {len(cell_of)} runs are missing in {options.runs_folder}"
    if not options.small:
        wanted = estimated(wanted, bar)
        left = [job for one in wanted for job in one.jobs if not job.done]
        text += f", about {hours(left, options.workers):.1f} hours"
    tell(f"{text}; after Ctrl-C, go on with `resume=True`")

    def done(job: Job) -> None:
        keep_if_done(cell_of[job.run])

    try:
        failed = do_jobs(left, options.workers, options.executor, done, tell, bar)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped in {options.runs_folder}: go on with `resume=True`"
        ) from None
    return wanted, failed


def _check_options(options: StudyOptions) -> None:
    check_positive(workers=options.workers)
    if options.seeds is not None:
        check_seeds(options.seeds)


def _datasets(options: StudyOptions, tell: Tell, bar: Bar) -> Datasets:
    small = options.runs_folder / "datasets" if options.small else None
    return Datasets(small, options.workers, options.executor, tell, bar)
