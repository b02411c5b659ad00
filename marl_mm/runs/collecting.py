"""Collecting into a dataset that survives whatever stops it."""

import shutil
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from marl_mm.collectors.collect import Collection, collect
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.config_diff import refuse_other_config
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.journal import FILE as JOURNAL
from marl_mm.datasets.journal import Journal, discard
from marl_mm.datasets.location import Location
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.provenance import Origin, Provenance
from marl_mm.datasets.storage import refuse_foreign, write_dataset
from marl_mm.declared import as_record
from marl_mm.envs.registry import DEFAULT, TASKS, config_dict, make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.episode import Episode
from marl_mm.errors import (
    DatasetError,
    HopelessError,
    MarlMmError,
    OtherConfigError,
    OutputExistsError,
    UsageError,
    WorkerDiedError,
)
from marl_mm.files import only_here, refuse_existing
from marl_mm.interrupts import deaf_to_interrupts
from marl_mm.plugins import record
from marl_mm.progress import Bar, silent_bar
from marl_mm.received import check_kind
from marl_mm.runs.settings import check_positive, check_seed, refuse_both
from marl_mm.sim.config import RECORDED_ENGINE, Engine, engine_overrides
from marl_mm.sim.world import check_engine
from marl_mm.versions import versions
from marl_mm.workers import Executor, check_place

_STEPS = 10_000

Attempts = dict[int, Episode | None]
"""Attempts by number; None for those that were not kept."""


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
    one that is started here (pip install -e '.[ray]')."""

    task: str = DEFAULT
    """Task to collect episodes of."""

    max_steps: int | None = None
    """Steps per episode; default the collector's, where it has some, or the task's."""

    engine: Engine | None = None
    """Engine of the simulation, bullet or mujoco; default bullet, or mujoco
    where PyBullet is not installed."""

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
    return _Collector(location, collector, config, options).collect(first, bar)


def recorded(location: Location) -> Provenance | None:
    """The record of the dataset at a location; None where there is none.

    Raises:
        DatasetError: If its metadata are damaged.
    """
    if not location.folder.exists():
        return None
    return Provenance.from_json(read_metadata(location)["marl_mm"])


class _Collector:
    """A policy that collects into one dataset; the arguments are as above."""

    def __init__(
        self, location: Location, name: str, config: Any, options: Collecting
    ) -> None:
        check_positive(workers=options.workers)
        if options.steps is not None:
            check_positive(steps=options.steps)
        check_seed(options.seed)
        refuse_both(options.resume, options.overwrite)
        collector, max_steps = COLLECTORS.get(name), options.max_steps
        if max_steps is None:
            max_steps = collector.max_steps or make_task(options.task).max_steps
        check_positive(max_steps=max_steps)
        overrides = {"max_steps": max_steps, **engine_overrides(options.engine)}
        self.location, self.options, self.keeps = location, options, collector.keeps
        self.task = make_task(options.task, overrides)
        check_place(options.executor, options.workers)
        self._refuse_existing()
        self.policy = collector.policy(config, self.task)
        self.about = Origin(
            task=options.task,
            overrides=overrides,
            config=config_dict(self.task),
            collector=name,
            collector_config=as_record(config),
            seed=options.seed,
            plugins=record(COLLECTORS.origin(name), TASKS.origin(options.task)),
            weights=self.policy.describe().get("weights"),
        )

    def _refuse_existing(self) -> None:
        location, resume = self.location, self.options.resume
        refuse_foreign(location)
        empty = location.folder.is_dir() and not any(location.folder.iterdir())
        if location.folder.exists() and not (self.options.overwrite or resume or empty):
            raise OutputExistsError(
                f"{location.name} exists already: add `resume=True` to go on with it, "
                "`overwrite=True` to replace it, or choose another `dataset`"
            )
        refuse_existing(location.folder, overwrite=True)
        begun = location.folder.exists() or (location.working / JOURNAL).exists()
        if resume and not begun:
            raise UsageError(
                f"nothing was begun at {location.folder}: leave out `resume` to start"
            )

    def collect(self, first: Location | None, bar: Bar) -> Collection:
        """Collect what is missing, and write the dataset."""
        location, options = self.location, self.options
        with only_here(location.working), ExitStack() as cleaning:
            cleaning.callback(_remove_if_empty, location)
            self._refuse_existing()  # another process may have been faster
            if options.overwrite:
                check_engine(self.task.simulation.engine)  # before anything is lost
                discard(location.working)
            with Journal(location.working) as journal:
                begun = journal.about() or {}
                replaces = options.overwrite or bool(begun.get("replaces"))
                stored = recorded(location) if options.resume and not replaces else None
                steps = self._steps(begun, stored)
                beside = stored or (recorded(first) if first else None)
                before = begun.get("packages") or (beside and beside.packages) or {}
                packages = _all_versions(before, versions())
                attempts: Attempts = {}
                for source in (first, location if stored else None):
                    attempts |= self._attempts(source)
                if stored and stored.complete and stored.steps_asked == steps:
                    cleaning.pop_all()
                    cleaning.callback(clear, location)
                    kept = [e for e in attempts.values() if e is not None]
                    return Collection(kept, len(attempts), complete=True)
                attempts |= self._begun(journal, steps, packages)
                try:
                    collection = self._run(journal, steps, attempts, bar)
                except HopelessError:
                    if not any(map(self.keeps, self._episodes(journal).values())):
                        journal.begin(self.about.to_json())  # empty, it is removed
                    raise
            self._refuse_loss(collection, replaces)
            self._write(collection, steps, packages)
            if collection.complete:
                cleaning.pop_all()  # the next collection's journal may be there
                clear(location)
        return collection

    def _steps(self, begun: dict[str, Any], stored: Provenance | None) -> int:
        """Number of steps to collect.

        Raises:
            UsageError: If more were asked for before.
        """
        before = (begun.get("steps_asked") or 0) if self.options.resume else 0
        if not isinstance(before, int) or before < 0:
            raise DatasetError(
                f"{self.location.working} is damaged: steps_asked is {before!r:.40}"
            )
        before = max(before, (stored and stored.steps_asked) or 0)
        asked = self.options.steps or before or _STEPS
        if asked < before:
            raise UsageError(
                f"`steps` is {asked}, {before} were asked for before: choose another "
                "`dataset`, or draw as many of these with marl-mm datasets mix"
            )
        return asked

    def _attempts(self, source: Location | None) -> Attempts:
        """The attempts behind a dataset, if it is there."""
        if source is None or not source.folder.exists():
            return {}
        dataset = load_dataset(source)
        self._refuse_other(source, dataset.metadata["marl_mm"])
        attempts: Attempts = dict.fromkeys(range(dataset.provenance.attempts or 0))
        return attempts | {episode.index: episode for episode in dataset.episodes}

    def _begun(
        self, journal: Journal, steps: int, packages: Mapping[str, str]
    ) -> Attempts:
        """Attempts in a journal; an empty one begins."""
        location, options, before = self.location, self.options, journal.about()
        if before is None:
            replaces = options.overwrite and location.folder.exists()
            more = {"steps_asked": steps, "replaces": replaces}
            journal.begin(self.about.to_json() | more | {"packages": packages})
            return {}
        if not options.resume:
            raise OutputExistsError(
                f"{location.name} was begun already; go on with `resume=True`, choose "
                "another `dataset` or add `overwrite=True`"
            )
        self._refuse_other(location, before)
        journal.note({**before, "steps_asked": steps, "packages": packages})
        return {**self._episodes(journal)}

    def _episodes(self, journal: Journal) -> dict[int, Episode]:
        return journal.episodes(self.task.layout)

    def _refuse_other(self, location: Location, metadata: dict[str, Any]) -> None:
        """Raise an OtherConfigError that says what else was collected there."""
        who, collector = metadata.get("collector"), self.about.collector
        if who not in (None, collector):
            raise OtherConfigError(
                f"{location.name} was collected by {who}, now asked for {collector}",
                "choose another `dataset` or add `overwrite=True`",
            )
        if config := metadata.get("config"):  # version 1 had one engine
            simulation = {"engine": RECORDED_ENGINE, **config.get("simulation", {})}
            metadata = {**metadata, "config": {**config, "simulation": simulation}}
        refuse_other_config(location.folder, metadata, self.about.to_json())

    def _run(
        self, journal: Journal, steps: int, attempts: Attempts, bar: Bar
    ) -> Collection:
        complete = False
        rollouts = Rollouts(self.task, self.options.workers, self.options.executor)
        try:
            collection = collect(
                self.policy,
                self.keeps,
                rollouts.completed,
                steps,
                self.options.seed,
                bar(f"collect {self.policy.name}", steps),
                attempts,
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

    def _refuse_loss(self, collection: Collection, replaces: bool) -> None:
        """Raise a KeyboardInterrupt instead of writing less than there is."""
        folder = self.location.folder
        if collection.complete:
            return
        if not collection.episodes:
            kept = ": go on with `resume=True`" if collection.attempts else ""
            raise KeyboardInterrupt(f"stopped before an episode was kept{kept}")
        if not folder.exists():
            return
        before = read_metadata(self.location)["marl_mm"]["episodes"]
        if replaces or before > len(collection.episodes):
            raise KeyboardInterrupt(
                f"stopped; {folder} is as it was, new episodes are kept beside it: go "
                "on with `resume=True`"
            )

    def _write(
        self, collection: Collection, steps: int, packages: Mapping[str, str]
    ) -> None:
        provenance = Provenance.collected(
            self.about,
            steps_asked=steps,
            packages=packages,
            attempts=collection.attempts,
            complete=collection.complete,
        )
        arrays = arrays_of(collection.episodes, self.location.id)
        try:
            with deaf_to_interrupts(forget=not collection.complete):
                write_dataset(self.location, arrays, provenance, overwrite=True)
        except OSError as error:  # no room
            raise MarlMmError(
                f"{error.strerror}: {error.filename}; finished episodes are kept: make "
                "room and go on with `resume=True`"
            ) from error
        except MarlMmError as error:
            kept = "finished episodes are kept, and `resume=True` writes them again"
            raise MarlMmError(f"{error}; {kept}") from error


def _all_versions(before: Any, now: Mapping[str, str]) -> dict[str, str]:
    """Versions by package: those that it began with, and where they differ of now."""
    check_kind(before, dict[str, str], "packages", DatasetError)
    every = {}
    for name, version in now.items():
        known = before.get(name, version)
        every[name] = known if version in known.split(", ") else f"{known}, {version}"
    return every


def clear(location: Location) -> None:
    """Forget the journal of a dataset that is complete."""
    shutil.rmtree(location.working)


def _remove_if_empty(location: Location) -> None:
    """No trace of a collection that kept nothing."""
    journal = location.working / JOURNAL
    if journal.exists():
        with Journal(location.working) as entries:
            if len(entries):
                return
        journal.unlink()
    if location.working.exists() and not any(location.working.iterdir()):
        location.working.rmdir()
