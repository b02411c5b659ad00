"""Collecting into a dataset that survives whatever stops it."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from typing import Any

from marl_mm.collectors.collect import Collection, collect
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.journal import FILE as JOURNAL
from marl_mm.datasets.journal import Journal
from marl_mm.datasets.location import Location
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.provenance import Origin, Provenance
from marl_mm.datasets.storage import refuse_foreign, write_dataset
from marl_mm.envs.registry import DEFAULT, TASKS, config_dict, make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.envs.task import Task
from marl_mm.episode import Episode
from marl_mm.errors import (
    HopelessError,
    MarlMmError,
    OutputExistsError,
    UsageError,
    WorkerDiedError,
)
from marl_mm.files import only_here, refuse_existing
from marl_mm.interrupts import deaf_to_interrupts
from marl_mm.layout import Layout
from marl_mm.plugins import record
from marl_mm.policy import Policy
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.collect_resume import (
    clear,
    is_complete,
    known_attempts,
    refuse_other,
    remove_if_empty,
)
from marl_mm.runs.settings import check_positive, check_seed, refuse_both
from marl_mm.workers import Executor

_STEPS = 10_000


@dataclass(frozen=True)
class Collecting:
    """Settings of every collection."""

    steps: int | None = None
    """Least number of steps; the last episode is kept whole. Default 10,000; when
    resuming as many as were asked for."""

    seed: int = 0
    """Seed of the dataset: attempt i is seeded from (seed, i)."""

    workers: int = 1
    """Processes; the dataset does not depend on their number."""

    executor: Executor = "local"
    """Processes of this machine, or of the Ray cluster that $RAY_ADDRESS names or of
    one that is started here (pip install 'marl-mm[ray]')."""

    task: str = DEFAULT
    """Task to collect episodes of."""

    max_steps: int | None = None
    """Steps per episode; default the collector's, where it has some, or the task's."""

    resume: bool = False
    """Go on where a collection was stopped, or with more steps where it ended. Settings
    that are left out are as they were."""

    overwrite: bool = False
    """Replace the dataset if it exists."""


def collect_dataset(
    location: Location,
    collector: str,
    config: Any,
    options: Collecting,
    first: Location | None = None,
    bar: Bar = silent_bar,
) -> Collection:
    """Collect and write one dataset; Ctrl-C leaves the episodes until then.

    Args:
        location: Location of the dataset.
        collector: Name of a registered collector.
        config: Settings of the collector.
        options: Settings of the collection.
        first: A shorter dataset of the same policy, task and seed to begin with.
        bar: Factory of progress bars.

    Raises:
        UsageError: If an argument makes no sense, the dataset exists, or another
            process is writing it.
        OtherConfigError: If what is to be resumed is of another policy, task or seed.
        KeyboardInterrupt: If Ctrl-C came before the first episode was kept.
    """
    check_positive(workers=options.workers)
    if options.steps is not None:
        check_positive(steps=options.steps)
    check_seed(options.seed)
    refuse_both(options.resume, options.overwrite)
    task, about = _about(collector, config, options)
    _refuse_existing(location, options)
    nothing = not location.folder.exists() and not location.working.exists()
    if options.resume and nothing:
        raise UsageError(
            f"nothing was begun at {location.folder}: leave out `resume` to start"
        )
    policy = COLLECTORS.get(collector).policy(config, task)
    keeps = COLLECTORS.get(collector).keeps
    about = replace(about, weights=policy.describe().get("weights"))
    with only_here(location.working), ExitStack() as cleaning:
        cleaning.callback(remove_if_empty, location)
        if options.overwrite:
            (location.working / JOURNAL).unlink(missing_ok=True)
        with Journal(location.working) as journal:
            begun = journal.about()
            replacing = options.overwrite or bool((begun or {}).get("replaces"))
            mine = location if options.resume and not replacing else None
            steps = _steps(options, begun, mine)
            known: dict[int, Episode | None] = {}
            for source in filter(None, (first, mine)):
                known |= known_attempts(source, about)
            if mine is not None and is_complete(mine, steps):
                cleaning.callback(clear, location)
                return Collection(_kept(known), len(known), complete=True)
            known |= _begun(journal, about, location, options, steps, task.layout)
            try:
                collection = _run(
                    policy, keeps, task, options, steps, known, journal, bar
                )
            except HopelessError:
                if not any(map(keeps, journal.episodes(task.layout).values())):
                    journal.begin(about.to_json())  # empty, it is removed
                raise
        _refuse_loss(location, collection, replacing)
        _write(location, collection, about, steps)
        if collection.complete:
            clear(location)
    return collection


def _refuse_existing(location: Location, options: Collecting) -> None:
    refuse_foreign(location)
    if location.folder.exists() and not (options.overwrite or options.resume):
        raise OutputExistsError(
            f"{location.name} exists already: add `resume=True` to go on with it, "
            "`overwrite=True` to replace it, or choose another `dataset`"
        )
    refuse_existing(location.folder, overwrite=True)


def _about(collector: str, config: Any, options: Collecting) -> tuple[Task, Origin]:
    """The task, and what the episodes depend on."""
    max_steps = options.max_steps
    if max_steps is None:
        usual = COLLECTORS.get(collector).max_steps
        max_steps = usual or make_task(options.task).max_steps
    check_positive(max_steps=max_steps)
    overrides = {"max_steps": max_steps}
    task = make_task(options.task, overrides)
    return task, Origin(
        task=options.task,
        overrides=overrides,
        config=config_dict(task),
        collector=collector,
        collector_config=asdict(config),
        seed=options.seed,
        plugins=record(COLLECTORS.origin(collector), TASKS.origin(options.task)),
    )


def _kept(known: dict[int, Episode | None]) -> list[Episode]:
    return [episode for episode in known.values() if episode is not None]


def _steps(
    options: Collecting, begun: dict[str, Any] | None, mine: Location | None
) -> int:
    """Number of steps to collect.

    Raises:
        UsageError: If more were asked for before.
    """
    before = (begun or {}).get("steps_asked", 0) if options.resume else 0
    if mine is not None and mine.folder.exists():
        asked = read_metadata(mine)["marl_mm"].get("steps_asked", 0)
        before = max(before, asked)
    if options.steps is None:
        return before or _STEPS
    if options.steps < before:
        raise UsageError(
            f"`steps` is {options.steps}, {before} were asked for before: choose "
            "another `dataset`, or draw as many of these with marl-mm datasets mix"
        )
    return options.steps


def _refuse_loss(location: Location, collection: Collection, replacing: bool) -> None:
    """Raise instead of writing less than there is.

    Raises:
        KeyboardInterrupt: Saying what is kept.
    """
    if collection.complete:
        return
    if not collection.episodes:
        raise KeyboardInterrupt("stopped before an episode was kept")
    if not location.folder.exists():
        return
    before = read_metadata(location)["marl_mm"]["episodes"]
    if replacing or before > len(collection.episodes):
        raise KeyboardInterrupt(
            f"stopped; {location.folder} is as it was, new episodes are kept beside "
            "it: go on with `resume=True`"
        )


def _begun(
    journal: Journal,
    about: Origin,
    location: Location,
    options: Collecting,
    steps: int,
    layout: Layout,
) -> dict[int, Episode | None]:
    """Attempts in a journal; a new one, or one to overwrite, begins."""
    before = journal.about()
    if before is not None and not (options.resume or options.overwrite):
        raise OutputExistsError(
            f"{location.name} was begun already; go on with `resume=True`, choose "
            "another `dataset` or add `overwrite=True`"
        )
    if before is None or options.overwrite:
        replaces = options.overwrite and location.folder.exists()
        journal.begin({**about.to_json(), "steps_asked": steps, "replaces": replaces})
        return {}
    refuse_other(location, before, about)
    journal.note({**before, "steps_asked": steps})
    return dict(journal.episodes(layout))


def _run(
    policy: Policy,
    keeps: Callable[[Episode], bool],
    task: Task,
    options: Collecting,
    steps: int,
    known: dict[int, Episode | None],
    journal: Journal,
    bar: Bar,
) -> Collection:
    complete = False
    rollouts = Rollouts(task, options.workers, options.executor)
    try:
        collection = collect(
            policy,
            keeps,
            rollouts.completed,
            steps,
            options.seed,
            bar(f"collect {policy.name}", steps),
            known,
            journal.add,
        )
        complete = collection.complete
    except WorkerDiedError as error:
        raise WorkerDiedError(
            f"{error}; finished episodes are kept: go on with `resume=True`"
        ) from error
    finally:
        # A second Ctrl-C must not cost what the first one left.
        with deaf_to_interrupts(forget=not complete):
            rollouts.close()
    return collection


def _write(
    location: Location,
    collection: Collection,
    about: Origin,
    steps: int,
) -> None:
    provenance = Provenance.collected(
        about,
        steps_asked=steps,
        attempts=collection.attempts,
        complete=collection.complete,
    )
    arrays = arrays_of(collection.episodes, location.id)
    try:
        with deaf_to_interrupts(forget=not collection.complete):
            write_dataset(location, arrays, provenance, overwrite=True)
    except (OSError, MarlMmError) as error:  # no room
        reason = str(error)
        if isinstance(error, OSError):
            reason = f"{error.strerror}: {error.filename}"
        raise MarlMmError(
            f"{reason}; finished episodes are kept: make room and go on with "
            "`resume=True`"
        ) from error
