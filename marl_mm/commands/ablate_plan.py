"""What ablations of offline learning lack, and how long it will take."""

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.speed import (
    matrix_products,
    prepare_for_small_networks,
    resolved,
)
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.commands.ablate_data import dataset_named, small_dataset
from marl_mm.commands.ablate_jobs import Job
from marl_mm.commands.ablate_options import AblateOffline
from marl_mm.commands.ablate_runs import ANOTHER_FOLDER
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import SHIPPED
from marl_mm.envs.registry import make_task
from marl_mm.errors import OtherConfigError, UnknownDatasetError, UsageError
from marl_mm.eval.ablation import Ablation, Cell, Probe, Setting, cell_name
from marl_mm.eval.evaluate import evaluate
from marl_mm.eval.tables import markdown_table
from marl_mm.progress import progress_bar
from marl_mm.runs.offline import (
    check_offline,
    offline_algorithm,
    task_of,
)
from marl_mm.runs.training import Offline, offline_training

_STEPS = 12
"""Of an evaluated episode, about, of agents that reach; others take all there are."""

_TIMED = 30
"""Updates that are timed, after as many that are not."""

_SMALL = {"updates": 120, "goals": 2, "max_steps": 2}
"""With the smoke budget."""


@dataclass(frozen=True)
class Wanted:
    """A cell whose rows are not all there."""

    cell: Cell
    probes: tuple[Probe, ...]
    jobs: tuple[Job, ...]
    """One per seed; some may be done."""

    @property
    def name(self) -> tuple[str, str]:
        """Of the cell."""
        return cell_name(self.cell)

    @property
    def runs(self) -> set[Path]:
        """Folders of the jobs."""
        return {job.run for job in self.jobs}


def missing_cells(
    options: AblateOffline, ablations: Iterable[Ablation]
) -> list[Wanted]:
    """Cells of some ablations without rows, each once, and the runs that make these.

    Raises:
        UsageError: If two settings share a name, or a dataset is not there and nobody
            knows how to make it; with ``--plan`` that is only told, and another stands
            for it.
        OtherConfigError: If there are rows or runs that were made with something else.
    """
    store = options.store()
    wanted = []
    datasets: dict[str, Dataset] = {}
    unknown: dict[str, str] = {}
    for cell, probes, asked in _cells(options, ablations):
        training = training_options(options, cell[1])
        made_of = _made_of(cell[1].algorithm, training)
        with _advising("name another folder with --out"):
            seeds = store.missing(cell, asked, probes, made_of)
        name = cell[0]
        if not seeds:
            continue
        if name not in (*datasets, *unknown):
            try:
                datasets[name] = _dataset(options, name)
            except UnknownDatasetError as error:
                unknown[name] = str(error)
        if name in unknown:
            if options.plan:
                stand_in = load_dataset(SHIPPED)
                jobs = _jobs(options, seeds, cell, probes, stand_in, training)
                wanted.append(Wanted(cell, probes, jobs))
            continue
        with _advising("name another folder with --out"):
            store.check_dataset(cell, datasets[name].identity())
        jobs = _jobs(options, seeds, cell, probes, datasets[name], training)
        runs = {job.seed: job.run for job in jobs}
        with _advising(ANOTHER_FOLDER):
            check_offline(datasets[name], training, runs, further=False)
        wanted.append(Wanted(cell, probes, jobs))
    if unknown:
        told = "; ".join(unknown.values())
        if not options.plan:
            raise UnknownDatasetError(told)
        print(f"counted as if learnt from good-5k: {told}", file=sys.stderr)
    return wanted


@contextmanager
def _advising(advice: str) -> Iterator[None]:
    """Say what to do about a difference."""
    try:
        yield
    except OtherConfigError as error:
        raise OtherConfigError(error.difference, advice) from error


def _cells(
    options: AblateOffline, ablations: Iterable[Ablation]
) -> list[tuple[Cell, tuple[Probe, ...], tuple[int, ...]]]:
    """Every cell once, with probes and seeds of all ablations that it stands in."""
    found: dict[tuple[str, str], tuple[Cell, tuple[Probe, ...], tuple[int, ...]]] = {}
    settings: dict[str, Setting] = {}
    for ablation in ablations:
        for cell in ablation.cells:
            _, setting = cell
            if settings.setdefault(setting.name, setting) != setting:
                raise UsageError(f"two settings are called {setting.name!r}")
            _, before, known = found.get(cell_name(cell), (cell, (), ()))
            probes = {probe.name: probe for probe in (*before, *ablation.probes)}
            seeds = dict.fromkeys((*known, *options.seeds_of(ablation)))
            found[cell_name(cell)] = cell, tuple(probes.values()), tuple(seeds)
    return list(found.values())


def training_options(options: AblateOffline, setting: Setting) -> Offline:
    """Options of one setting's runs."""
    small = options.budget == "smoke"
    changes = {"precision": resolved(options.precision), **setting.changes}
    if small:
        changes["updates"] = _SMALL["updates"]
    training = offline_training(
        setting.algorithm,
        setting.preset,
        eval_episodes=_SMALL["goals"] if small else setting.goals,
        curve_every=setting.curve_every,
        curve_episodes=_SMALL["goals"] if small else setting.curve_goals,
        max_steps=_SMALL["max_steps"] if small else setting.max_steps,
        workers=1,
        stop_unsound=False,  # a table's runs have all their updates
        resume=True,  # what there is of them
    )
    return replace(training, config=replace(training.config, **changes))


def _made_of(algorithm: str, training: Offline) -> dict[str, Any]:
    """What rows must have been made of; the seeds and the dataset stand elsewhere."""
    own = ("eval_episodes", "eval_seed", "curve_every", "curve_episodes", "max_steps")
    config = asdict(training.config)
    del config["precision"]  # is what was best where they were made
    return {
        "algorithm": algorithm,
        **config,
        **{name: getattr(training, name) for name in own},
    }


def _dataset(options: AblateOffline, name: str) -> Dataset:
    if options.budget == "smoke":
        data = options.runs_folder() / "datasets"
        return small_dataset(name, data, make=not options.plan)
    return dataset_named(name, options.workers, make=not options.plan)


def _jobs(
    options: AblateOffline,
    seeds: Sequence[int],
    cell: Cell,
    probes: tuple[Probe, ...],
    dataset: Dataset,
    training: Offline,
) -> tuple[Job, ...]:
    name, setting = cell
    short = "-".join(name.removeprefix("marl_mm/").split("-")[:2])
    folder = options.runs_folder() / name.replace("/", "-") / setting.name
    if options.executor == "ray":  # whose workers are elsewhere
        folder = folder.absolute()
    return tuple(
        Job(
            f"{setting.name} {seed} {short}",
            seed,
            folder / str(seed),
            dataset.location,
            training,
            probes,
        )
        for seed in seeds
    )


# --- How long ----------------------------------------------------------------


def estimated(wanted: list[Wanted]) -> list[Wanted]:
    """With how long each job will take, from short measurements on this machine."""
    per_update: dict[str, float] = {}
    per_step: dict[str, float] = {}
    known = []
    with progress_bar("measuring", len(wanted)) as advance:
        for one in wanted:
            jobs = []
            for job in one.jobs:
                if not job.done:
                    dataset = load_dataset(job.dataset)
                    name, task = one.cell[1].name, task_of(dataset, job.options)
                    if name not in per_update:
                        per_update[name] = _seconds_per_update(dataset, job.options)
                    if task not in per_step:
                        per_step[task] = _seconds_per_step(task)
                    job = replace(
                        job,
                        seconds=_seconds(job, per_update[name], per_step[task]),
                    )
                jobs.append(job)
            known.append(replace(one, jobs=tuple(jobs)))
            advance(1, "")
    return known


def _seconds(job: Job, per_update: float, per_step: float) -> float:
    """What is missing of a job, about."""
    options = job.options
    rows = read_metrics(job.run) if (job.run / FILE).exists() else []
    updates = options.config.updates - (rows[-1]["step"] if rows else 0)
    probes = [probe for probe in job.probes if not job.has(probe)]
    points = -(-updates // options.curve_every) + (not rows)
    goals = len(probes) * options.eval_episodes + points * options.curve_episodes
    most = options.max_steps or make_task().max_steps
    steps = most if options.preset == "paper" else _STEPS
    return float(updates * per_update + goals * steps * per_step)


def _seconds_per_update(dataset: Dataset, options: Offline) -> float:
    prepare_for_small_networks()
    algorithm = offline_algorithm(dataset, options, [0])
    with matrix_products(options.config.precision):
        for _ in range(_TIMED):
            algorithm.update()
        begin = perf_counter()
        for _ in range(_TIMED):
            algorithm.update()
    return (perf_counter() - begin) / _TIMED


def _seconds_per_step(task: str) -> float:
    evaluate(RandomPolicy(RandomConfig()), 1, task=task)  # compiles
    begin = perf_counter()
    evaluation = evaluate(RandomPolicy(RandomConfig()), 3, task=task)
    steps: int = sum(row["steps"] for row in evaluation.rows)
    return (perf_counter() - begin) / steps


def hours(jobs: Sequence[Job], workers: int) -> float:
    """Until these jobs are done, about."""
    return sum(job.seconds for job in jobs if not job.done) / workers / 3600


def plan_table(wanted: Sequence[Wanted], workers: int, measured: bool) -> str:
    """What is missing, a line per cell, as Markdown; the last one is the sum.

    Args:
        wanted: What is.
        workers: Runs at once.
        measured: Whether it is known how long jobs take.
    """

    def line(dataset: str, setting: str, jobs: Sequence[Job]) -> list[str]:
        left = [job for job in jobs if not job.done]
        told = [f"{hours(left, workers):.2f}"] if measured else []
        return [dataset, setting, f"{len(left)} of {len(jobs)}", *told]

    lines = [line(one.cell[0], one.cell[1].about, one.jobs) for one in wanted]
    lines.append(line("all", "", [job for one in wanted for job in one.jobs]))
    header = ["dataset", "setting", "runs missing"]
    header += [f"hours, {workers} at once"] if measured else []
    return markdown_table(header, lines)
