"""Missing runs of studies, and the time that they will take."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import groupby

from marl_mm.datasets.dataset import Dataset, existing
from marl_mm.errors import OtherConfigError, UsageError
from marl_mm.eval.studies.cost import GoalTimes
from marl_mm.eval.studies.jobs import Job
from marl_mm.eval.studies.learners import Learner, made_of, training_of
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.settings import Online, Probe, Setting, name_of
from marl_mm.eval.studies.study import Cell, Study, cell_name
from marl_mm.eval.tables import markdown_table
from marl_mm.progress import Bar
from marl_mm.runs.collecting import recorded
from marl_mm.runs.making import Datasets
from marl_mm.runs.sources import Data, Mix, Source
from marl_mm.sim.config import Engine, engine_of


def missing_jobs(
    options: StudyOptions, studies: Iterable[Study], datasets: Datasets
) -> list[Job]:
    """Jobs of the cells of some studies without rows, each cell once; some may be done.

    Raises:
        UsageError: If two settings share a name, a dataset is missing and has no
            source to make it from, or data or rows are of another engine.
        OtherConfigError: If there are rows or runs that were made with something else.
    """
    jobs: list[Job] = []
    loaded: dict[str, Dataset] = {}
    cells = _cells(options, studies)
    engines = options.store.engines([cell for cell, _, _ in cells], options.engine)
    for cell, probes, asked in cells:
        source, setting = cell
        engine = engines[cell_name(cell)]
        how = options.small, options.precision, engine, options.device
        task = _task_of(source)
        training = training_of(source, setting, task, *how)
        record = made_of(setting, training)
        if task is not None:
            record.setdefault("task", task)
        seeds = options.store.missing(cell, asked, probes, record, training.config)
        if not seeds:
            continue
        location, there = None, True
        data = source.demonstrations if isinstance(source, Online) else source
        if data is not None:
            name = name_of(data)
            loaded[name] = loaded.get(name) or datasets.get(data)
            location = loaded[name].location
            there = not datasets.stands_in(loaded[name], data)
            if there:
                _check_engine(loaded[name], engine)
                options.store.check_dataset(cell, loaded[name].identity())
        learner = Learner(training, location, setting.library == "sb3")
        runs = {seed: options.run_folder(cell, seed) for seed in seeds}
        try:
            if there:
                learner.check(runs)
        except OtherConfigError as error:
            advice = "name another folder with `runs`, or delete this one"
            raise OtherConfigError(error.difference, advice) from error
        jobs += [Job(cell, seed, run, learner, probes) for seed, run in runs.items()]
    return jobs


def _task_of(source: Data | Online) -> str | None:
    """Task of a cell's data; None online, and where the data are not there."""
    if isinstance(source, str):
        there = recorded(existing(source))
        return None if there is None else there.task
    return None if isinstance(source, Online) else source.task


def _check_engine(dataset: Dataset, engine: Engine) -> None:
    """Raise a UsageError for a dataset of another engine than its cell."""
    given = engine_of(dataset.provenance.overrides)
    if given != engine:
        raise UsageError(
            f"dataset {dataset.location.name} is of engine {given}, expected {engine}: "
            f"ask for `engine` {given}, and let the overrides of a Probe name the other"
        )


def by_cell(jobs: Iterable[Job]) -> list[list[Job]]:
    """Jobs that follow each other, a list per cell."""
    return [[*group] for _, group in groupby(jobs, key=lambda job: cell_name(job.cell))]


def _cells(
    options: StudyOptions, studies: Iterable[Study]
) -> list[tuple[Cell, tuple[Probe, ...], tuple[int, ...]]]:
    """Every cell once, with probes and seeds of all studies that it stands in."""
    asked: dict[tuple[str, str], tuple[Cell, tuple[Probe, ...], tuple[int, ...]]] = {}
    settings: dict[str, Setting] = {}
    sources: dict[str, Source | Mix] = {}
    for study in studies:
        for cell in study.cells:
            source, setting = cell
            if isinstance(source, Source | Mix):
                if sources.setdefault(source.name, source) != source:
                    raise UsageError(f"two sources are called {source.name!r}")
            if settings.setdefault(setting.name, setting) != setting:
                raise UsageError(f"two settings are called {setting.name!r}")
            _, before, earlier = asked.get(cell_name(cell), (cell, (), ()))
            probes = {probe.name: probe for probe in (*before, *study.probes)}
            seeds = dict.fromkeys((*earlier, *options.seeds_of(study)))
            asked[cell_name(cell)] = cell, tuple(probes.values()), tuple(seeds)
    return list(asked.values())


# --- How long ----------------------------------------------------------------

CORES = 2, 16, 64
"""Numbers of cores for which a plan says the time."""


def estimated(jobs: Sequence[Job], bar: Bar) -> list[Job]:
    """Jobs with their estimated durations, measured on this machine."""
    per_update: dict[tuple[str, str, int], float] = {}
    timed, goal_times = [], GoalTimes()
    seeds = Counter(cell_name(job.cell) for job in jobs if not job.trained)
    advance = bar("measuring", len(jobs))
    for job in jobs:
        source, setting = job.cell
        task = setting.task or getattr(source, "task", None) or job.learner.task
        training, seconds = job.learner.training, 0.0
        per_goal = 0.0 if job.done else goal_times(task, training.overrides)
        if not job.trained:
            together = seeds[cell_name(job.cell)]
            key = setting.name, task, together if training.side_by_side else 1
            if key not in per_update:
                per_update[key] = job.learner.seconds_per_update(together)
            seconds = job.learner.seconds_left(job.run, per_update[key], per_goal)
        probes = sum(not job.has(probe) for probe in job.probes)
        seconds += probes * training.eval_episodes * per_goal
        timed.append(replace(job, seconds=seconds))
        advance(1, "")
    return timed


def hours(jobs: Iterable[Job], workers: int) -> float:
    """Estimated hours until these jobs are done."""
    return sum(job.seconds for job in jobs) / workers / 3600


def cost(jobs: Sequence[Job]) -> str:
    """Estimated hours of these jobs on more and more cores, a run on each, in words.

    Cores are like this machine's; no number of them is faster than the longest run.
    """
    left = [job for job in jobs if not job.done]
    longest = max((job.seconds for job in left), default=0.0) / 3600
    times = [f"{max(hours(left, n), longest):.2f} on {n}" for n in CORES]
    return (
        f"Hours by the number of cores, of all machines together: {', '.join(times)}."
    )


def plan_table(jobs: Sequence[Job], workers: int, measured: bool) -> str:
    """Missing runs, a line per cell and their sum, as Markdown, and what they cost."""

    def line(source: str, about: str, jobs: Sequence[Job]) -> list[str]:
        left = [job for job in jobs if not job.done]
        time = [f"{hours(left, workers):.2f}"] if measured else []
        return [source, about, f"{len(left)} of {len(jobs)}", *time]

    lines = []
    for group in by_cell(jobs):
        source, setting = group[0].cell
        lines.append(line(name_of(source), setting.about, group))
    lines.append(line("all", "", jobs))
    header = ["dataset", "setting", "runs missing"]
    header += [f"hours, {workers} at once"] if measured else []
    on_cores = measured and not any(j.learner.training.side_by_side for j in jobs)
    return markdown_table(header, lines) + f"\n{cost(jobs)}\n" * on_cores
