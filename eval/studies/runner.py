"""Runs studies: what is missing is trained, its rows are kept, and tables are drawn."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from marl_mm.errors import FailedRunsError, MarlMmError
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies import offline
from marl_mm.eval.studies.jobs import Job, do_jobs
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.plan import (
    by_cell,
    estimated,
    hours,
    missing_jobs,
    plan_table,
)
from marl_mm.eval.studies.shown import Curves
from marl_mm.eval.studies.study import Study, cell_name
from marl_mm.eval.studies.summary import summarize
from marl_mm.eval.studies.table import Table
from marl_mm.files import refuse_existing
from marl_mm.progress import Bar, silent_bar
from marl_mm.received import damage_named
from marl_mm.runs.making import Datasets, Notify, silence
from marl_mm.runs.paper import PAPER

Studies = Mapping[str, Study]
"""Studies by the name of their files."""


_DECLARED = {source.name: source for source in (*PAPER, *offline.OTHER_TASKS)}
"""Declared sources by their short names."""


@dataclass(frozen=True)
class StudyRunner:
    """Runs studies.

    Raises:
        UsageError: If an option makes no sense.
    """

    options: StudyOptions
    """Settings of how studies are run."""

    notify: Notify = silence
    """Callback for messages to the user."""

    bar: Bar = silent_bar
    """Factory of progress bars, called in a thread."""

    def __post_init__(self) -> None:
        """Check the options."""
        self.options.check_settings()

    def run(self, studies: Studies) -> Iterator[tuple[str, Table]]:
        """Make what is missing of some studies, draw them, and yield their tables.

        Raises:
            UsageError: If a table exists, or a dataset is not there.
            OtherConfigError: If rows or runs there were made with something else.
            FailedRunsError: At the end; what could be drawn has been.
            KeyboardInterrupt: After Ctrl-C, saying how to go on.
        """
        again = self.options.overwrite or self.options.resume
        for name, study in studies.items():
            for end in (".csv", ".png")[: 1 + bool(study.figure)]:
                refuse_existing(self.options.results / f"{name}{end}", again)
        failed: FailedRunsError | None = None
        try:
            self.make_rows(studies)
        except FailedRunsError as error:
            failed = error
        for name, study in studies.items():
            if failed is None or not self._jobs({name: study}):
                yield name, self.draw(name, study, self.options.results)
        if failed is not None:
            raise failed

    def plan(self, studies: Studies) -> str:
        """Missing runs, and the estimated time that they will take, as Markdown.

        Raises:
            OtherConfigError: If rows there were made with something else.
        """
        jobs = self._jobs(studies, plan=True)
        if not self.options.small:
            jobs = estimated(jobs, self.bar)
        return plan_table(jobs, self.options.workers, not self.options.small)

    def draw(self, name: str, study: Study, folder: Path) -> Table:
        """Write a study's table, and its figure if it has one, from its rows.

        Args:
            name: Name of the files.
            study: The study.
            folder: Folder of the files.

        Raises:
            UsageError: If rows are missing, or of another engine.
        """
        store, seeds = self.options.store, self.options.seeds_of(study)
        with damage_named(f"{store.folder}, rows of {name}", MarlMmError):
            rows = summarize(study, store, seeds, self.options.engine)
        write_csv(folder / f"{name}.csv", rows)
        if not study.figure:
            return Table(study, rows)
        from marl_mm.eval.studies.figures import curves_figure  # imports matplotlib

        curves = study.figure if isinstance(study.figure, Curves) else Curves()
        figure = folder / f"{name}.png"
        curves_figure(study, curves, store, seeds, figure)
        return Table(study, rows, figure)

    def make_rows(self, studies: Studies) -> None:
        """Do what is missing; a cell's rows are kept as soon as all its runs are done.

        Raises:
            FailedRunsError: If runs failed; the others are done.
            KeyboardInterrupt: After Ctrl-C, saying how to go on.
        """
        options = self.options
        lacking: list[str] = []  # what a plan says of datasets that are not there
        planned = replace(self, notify=lacking.append)._jobs(studies, plan=True)
        seconds = self._announce(planned) if lacking else {}
        jobs = self._jobs(studies)  # which collects what is lacking
        of_cells = {cell_name(group[0].cell): group for group in by_cell(jobs)}

        def keep_if_done(job: Job) -> None:
            group = of_cells[cell_name(job.cell)]
            if all(other.done for other in group):
                runs = {other.seed: other.run for other in group}
                options.store.keep(job.cell, runs, job.probes)

        for first, *_ in of_cells.values():
            keep_if_done(first)
        if all(job.done for job in jobs):
            return
        seconds = seconds or self._announce(jobs)
        left = [replace(job, seconds=seconds[job.run]) for job in jobs if not job.done]
        pool = options.workers, options.executor
        try:
            failed = do_jobs(left, *pool, keep_if_done, self.notify, self.bar)
        except KeyboardInterrupt:
            text = f"stopped in {options.runs_folder}: go on with `resume=True`"
            raise KeyboardInterrupt(text) from None
        if failed:
            reasons = "; ".join(f"{run}: {why}" for run, why in failed.items())
            raise FailedRunsError(
                f"{len(failed)} of {len(jobs)} runs failed, the same with "
                f"`resume=True` tries them again: {reasons}"
            )

    def _announce(self, jobs: Sequence[Job]) -> dict[Path, float]:
        """Say how long training and evaluation will take.

        Returns:
            Estimated time of each run [s], 1 for all of them with few steps.
        """
        options = self.options
        left = [job for job in jobs if not job.done]
        if left:
            text = f"{len(left)} of {len(jobs)} runs are missing"
            text = f"{text} in {options.runs_folder}"
            if not options.small:
                left = estimated(left, self.bar)
                text = f"{text}, about {hours(left, options.workers):.1f} hours"
            self.notify(f"{text}; after Ctrl-C, go on with `resume=True`")
        return {job.run: job.seconds for job in left}

    def _jobs(self, studies: Studies, plan: bool = False) -> list[Job]:
        """Runs without rows; their datasets are made, or with ``plan`` looked for."""
        options = self.options
        small = options.runs_folder / "datasets" if options.small else None
        pool = options.workers, options.executor
        tools = *pool, self.notify, self.bar, _DECLARED
        datasets = Datasets(small, *tools, plan=plan, engine=options.engine)
        return missing_jobs(options, studies.values(), datasets)
