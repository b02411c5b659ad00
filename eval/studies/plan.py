"""Missing runs of studies, and the time that they will take."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from marl_mm.datasets.dataset import Dataset
from marl_mm.errors import OtherConfigError, UsageError
from marl_mm.eval.studies.jobs import Job
from marl_mm.eval.studies.learners import GOAL, Learner, made_of, training_of
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.study import (
    Cell,
    Online,
    Probe,
    Setting,
    Study,
    cell_name,
    name_of,
)
from marl_mm.eval.tables import markdown_table
from marl_mm.progress import Bar
from marl_mm.runs.sources import Datasets


@dataclass(frozen=True)
class Wanted:
    """A cell with missing rows."""

    cell: Cell
    """Source and setting."""

    probes: tuple[Probe, ...]
    """Evaluations of each run."""

    jobs: tuple[Job, ...]
    """Jobs, one per seed; some may be done."""


def missing_cells(
    options: StudyOptions, studies: Iterable[Study], datasets: Datasets
) -> list[Wanted]:
    """Cells of some studies without rows, each once, and the runs that make these.

    Raises:
        UsageError: If two settings share a name, or a dataset is not there and nobody
            knows how to make it.
        OtherConfigError: If there are rows or runs that were made with something else.
    """
    wanted = []
    known: dict[str, Dataset] = {}
    for cell, probes, asked in _cells(options, studies):
        source, setting = cell
        training = training_of(source, setting, options.small, options.precision)
        record = made_of(setting, training)
        seeds = options.store.missing(cell, asked, probes, record)
        if not seeds:
            continue
        location = None
        data = source.demonstrations if isinstance(source, Online) else source
        if data is not None:
            name = name_of(data)
            known[name] = known.get(name) or datasets.get(data)
            location = known[name].location
            if not datasets.plan:
                options.store.check_dataset(cell, known[name].identity())
        learner = Learner(training, location, setting.library == "sb3")
        runs = {seed: run_folder(options, cell, seed) for seed in seeds}
        try:
            if not datasets.plan:
                learner.check(runs)
        except OtherConfigError as error:
            advice = "name another folder with `runs`, or delete this one"
            raise OtherConfigError(error.difference, advice) from error
        short = "-".join(name_of(source).removeprefix("marl_mm/").split("-")[:2])
        jobs = (
            Job(f"{setting.name} {seed} {short}", seed, run, learner, probes)
            for seed, run in runs.items()
        )
        wanted.append(Wanted(cell, probes, tuple(jobs)))
    return wanted


def _cells(
    options: StudyOptions, studies: Iterable[Study]
) -> list[tuple[Cell, tuple[Probe, ...], tuple[int, ...]]]:
    """Every cell once, with probes and seeds of all studies that it stands in."""
    found: dict[tuple[str, str], tuple[Cell, tuple[Probe, ...], tuple[int, ...]]] = {}
    settings: dict[str, Setting] = {}
    for study in studies:
        for cell in study.cells:
            _, setting = cell
            if settings.setdefault(setting.name, setting) != setting:
                raise UsageError(f"two settings are called {setting.name!r}")
            _, before, known = found.get(cell_name(cell), (cell, (), ()))
            probes = {probe.name: probe for probe in (*before, *study.probes)}
            seeds = dict.fromkeys((*known, *options.seeds_of(study)))
            found[cell_name(cell)] = cell, tuple(probes.values()), tuple(seeds)
    return list(found.values())


def run_folder(options: StudyOptions, cell: Cell, seed: int) -> Path:
    """Folder of a cell's run."""
    source, setting = cell_name(cell)
    folder = options.runs_folder / source.replace("/", "-") / setting / str(seed)
    return folder.absolute() if options.executor == "ray" else folder  # is elsewhere


# --- How long ----------------------------------------------------------------


def estimated(wanted: Sequence[Wanted], bar: Bar) -> list[Wanted]:
    """Cells with the estimated duration of each job, measured on this machine."""
    per_update: dict[str, float] = {}
    known = []
    advance = bar("measuring", len(wanted))
    for item in wanted:
        name, jobs = item.cell[1].name, []
        for job in item.jobs:
            if not job.done:
                if name not in per_update:
                    per_update[name] = job.learner.seconds_per_update()
                probes = sum(not job.has(probe) for probe in job.probes)
                seconds = probes * job.learner.training.eval_episodes * GOAL
                if not job.trained:
                    seconds += job.learner.seconds_left(job.run, per_update[name])
                job = replace(job, seconds=seconds)
            jobs.append(job)
        known.append(replace(item, jobs=tuple(jobs)))
        advance(1, "")
    return known


def hours(jobs: Iterable[Job], workers: int) -> float:
    """Estimated hours until these jobs are done."""
    return sum(job.seconds for job in jobs if not job.done) / workers / 3600


def plan_table(wanted: Sequence[Wanted], workers: int, measured: bool) -> str:
    """Missing runs, a line per cell, as Markdown; the last line is the sum."""

    def line(source: str, about: str, jobs: Sequence[Job]) -> list[str]:
        left = [job for job in jobs if not job.done]
        time = [f"{hours(left, workers):.2f}"] if measured else []
        return [source, about, f"{len(left)} of {len(jobs)}", *time]

    lines = [line(name_of(w.cell[0]), w.cell[1].about, w.jobs) for w in wanted]
    lines.append(line("all", "", [job for w in wanted for job in w.jobs]))
    header = ["dataset", "setting", "runs missing"]
    header += [f"hours, {workers} at once"] if measured else []
    return markdown_table(header, lines)
