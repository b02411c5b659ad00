"""Datasets as declarations: what is missing of them is collected or mixed."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.config_diff import as_json
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import SHIPPED, Location, locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.recipe import Part, mix, write_mix
from marl_mm.declared import as_record, plain
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.errors import DatasetError, UnknownDatasetError, UsageError
from marl_mm.files import only_here
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.collecting import Collecting, collect_dataset, recorded
from marl_mm.runs.settings import check_positive, check_seed, with_settings
from marl_mm.sim.config import (
    RECORDED_ENGINE,
    Engine,
    default_engine,
    engine_of,
    engine_overrides,
)
from marl_mm.workers import Executor

FEW = 30
"""Steps of a source where hardly anything is trained."""

Notify = Callable[[str], None]
"""Callback for messages to the user."""


def silence(text: str) -> None:
    """For callers who want no messages."""


def task_folder(task: str) -> str:
    """Folder of a task's datasets, such as quiet-zone-hard of QuietZone-hard-v0."""
    name = task.removesuffix("-v0")
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).lower()


@dataclass(frozen=True)
class Source:
    """A dataset of one collector, which is collected where it is missing."""

    collector: str = "pd"
    """Registered name of the collector."""

    task: str = DEFAULT
    """Registered name of the task."""

    steps: int = 10_000
    """Least number of steps; the last episode is kept whole."""

    seed: int = 0
    """Seed of the collection."""

    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the collector that are not its defaults."""

    name: str = ""
    """Id of the dataset, or a word that is short for one; default made of the fields
    above."""

    first: "Source | None" = None
    """Shorter source of the same collector, task and seed that this one begins with."""

    engine: Engine | None = None
    """Engine of the simulation, bullet or mujoco; default that of the study."""

    def __post_init__(self) -> None:
        """Refuse what cannot be collected, and name it."""
        for name in ("steps", "seed"):
            object.__setattr__(self, name, plain(getattr(self, name)))
        make_task(self.task, engine_overrides(self.engine))
        check_positive(steps=self.steps)
        check_seed(self.seed)
        _ = self.config
        if not self.name:
            words = self.collector, self.task.removesuffix("-v0"), self.steps, self.seed
            settings = (f"{name}-{value}" for name, value in self.settings.items())
            parts = [*words, *(text.replace("--", "-minus-") for text in settings)]
            parts += [self.engine] if self.engine else []
            slug = re.sub(r"[^A-Za-z0-9]+", "-", "-".join(map(str, parts)))
            object.__setattr__(self, "name", slug.strip("-").lower())

    @property
    def config(self) -> Any:
        """Settings of the collector."""
        default = COLLECTORS.get(self.collector).config()
        return with_settings(f"collector {self.collector}", default, self.settings)

    def made(self, record: Provenance) -> bool:
        """Whether a dataset with this record is the source's, with all its steps."""
        config = as_json(as_record(self.config))
        engine = self.engine or RECORDED_ENGINE
        expected = self.task, self.collector, config, engine, self.seed, self.steps
        config = as_json(dict(record.collector_config or {}))
        actual = record.task, record.collector, config, engine_of(record.overrides)
        numbers = record.seed, record.steps_asked
        longest = COLLECTORS.get(self.collector).max_steps
        longest = longest or make_task(self.task).max_steps
        return (
            record.complete
            and (*actual, *numbers) == expected
            and record.overrides.get("max_steps", longest) == longest
        )


@dataclass(frozen=True)
class Mix:
    """A dataset of episodes drawn from sources, which is made where it is missing."""

    name: str
    """Id of the dataset, or a word that is short for one."""

    parts: Sequence[tuple[Source, int]]
    """Sources, and how many steps are drawn from each, at least."""

    seed: int = 0
    """Seed of the draw."""

    def __post_init__(self) -> None:
        """Refuse a mix of nothing, and take numbers of NumPy's."""
        if not self.parts:
            raise UsageError(f"mix {self.name!r} has no parts, expected at least one")
        parts = ((source, plain(steps)) for source, steps in self.parts)
        object.__setattr__(self, "parts", tuple(parts))
        object.__setattr__(self, "seed", plain(self.seed))
        check_seed(self.seed)

    @property
    def task(self) -> str:
        """Registered name of the task of its sources."""
        return self.parts[0][0].task


Data = Source | Mix | str
"""A dataset: one that is made where it is missing, or the id or path of one."""


def seeded(data: Source | Mix, seed: int) -> Source | Mix:
    """A declaration, and all that it begins with or is drawn from, of another seed."""
    if isinstance(data, Source):
        return _seeded(data, seed)
    parts = [(_seeded(source, seed), steps) for source, steps in data.parts]
    return replace(data, seed=seed, parts=parts)


def _seeded(source: Source, seed: int) -> Source:
    first = source.first and _seeded(source.first, seed)
    return replace(source, seed=seed, first=first)


def engine_named_by(data: Data) -> Engine | None:
    """Engine that a declaration names; None where it leaves that open."""
    if isinstance(data, Mix):
        return next((source.engine for source, _ in data.parts if source.engine), None)
    return data.engine if isinstance(data, Source) else None


def on_engine(data: Source | Mix, engine: Engine | None) -> Source | Mix:
    """A declaration, and all that it begins with or is drawn from, on an engine.

    One that names an engine stays. The others' names end in the engine's, if it is not
    PyBullet, as which one without an engine counts from here on.

    Args:
        data: The declaration.
        engine: The engine; None is the default one.
    """
    engine = engine or default_engine()
    if engine == RECORDED_ENGINE or engine_named_by(data) is not None:
        return data
    name = re.sub(r"(-v\d+)?$", rf"-{engine}\1", data.name, count=1)
    if isinstance(data, Source):
        first: Any = data.first and on_engine(data.first, engine)
        return replace(data, engine=engine, name=name, first=first)
    parts: Any = [(on_engine(source, engine), steps) for source, steps in data.parts]
    return replace(data, name=name, parts=parts)


@dataclass(frozen=True)
class Datasets:
    """Datasets of sources, in the datasets' root or, of few steps, in a folder."""

    small: Path | None = None
    """Folder of datasets of few steps; None: they have as many as declared."""

    workers: int = 1
    """Processes that collect."""

    executor: Executor = "local"
    """Processes of this machine, or of a Ray cluster."""

    notify: Notify = silence
    """Callback for messages to the user."""

    bar: Bar = silent_bar

    declared: Mapping[str, Source | Mix] = field(default_factory=dict)
    """Declared sources by the word that an id is short for."""

    scale: float = 1.0
    """Share of the declared steps."""

    overwrite: bool = False
    """Replace what is damaged, of another declaration or of more steps."""

    plan: bool = False
    """Whether nothing is made: the dataset that ships counts for what could be."""

    engine: Engine | None = None
    """Engine of sources that name none."""

    def get(self, data: Data) -> Dataset:
        """A dataset; what is missing of it is made, but for a plan."""
        data = self._declared(data)
        if not self.plan or isinstance(data, str):
            return self.make(data)
        try:
            return self.find(data)
        except UnknownDatasetError as error:
            self.notify(f"counted as if learnt from good-5k: {error}")
            return load_dataset(SHIPPED)

    def stands_in(self, dataset: Dataset, data: Data) -> bool:
        """Whether what ``get`` returned counts for what a plan could not find."""
        named = isinstance(self._declared(data), str)
        return self.plan and not named and dataset.location == locate(SHIPPED)

    def find(self, data: Data) -> Dataset:
        """A dataset that is there and whole; an UnknownDatasetError if it is not."""
        data = self._declared(data)
        if isinstance(data, str):
            return load_dataset(data)
        location = self._location(data)
        if not self._whole(data, location):
            raise UnknownDatasetError(
                f"no dataset {data.name}: {self._deed(data)} first"
            )
        return load_dataset(location)

    def make(self, data: Data) -> Dataset:
        """A dataset; what is missing of it is made.

        Raises:
            UnknownDatasetError: If there is none, and no source to make it from.
            OtherConfigError: If another collection has its name.
            KeyboardInterrupt: After Ctrl-C; the same call goes on.
        """
        data = self._declared(data)
        if isinstance(data, str):
            return load_dataset(data)
        location = self._location(data)
        if not self._whole(data, location):
            for source in self._made_of(data):
                self.make(source)
        with only_here(location.folder.parent, wait=True):  # others may make it, too
            if not self._whole(data, location):
                begun = location.folder.exists() or location.working.exists()
                state = "is not whole, or another" if begun else "is not there"
                self.notify(f"dataset {data.name} {state}: {self._deed(data)}")
                if isinstance(data, Source):
                    self._collect(data, location, begun)
                else:
                    self._mix(data, location)
        return load_dataset(location)

    def _collect(self, source: Source, location: Location, begun: bool) -> None:
        collecting = Collecting(
            steps=self._steps(source.steps),
            seed=source.seed,
            task=source.task,
            engine=source.engine or RECORDED_ENGINE,
            workers=1 if self.small else self.workers,  # few episodes are over at once
            executor=self.executor,
            resume=begun,
        )
        first = next(map(self._location, self._made_of(source)), None)
        what = location, source.collector, source.config
        try:
            collection = collect_dataset(*what, collecting, first, self.bar)
        except (UsageError, DatasetError):
            if not (begun and self.overwrite):
                raise
            anew = replace(collecting, resume=False, overwrite=True)
            collection = collect_dataset(*what, anew, first, self.bar)
        if not collection.complete:
            raise KeyboardInterrupt(f"stopped in {source.name}; the same call goes on")

    def _mix(self, data: Mix, location: Location) -> None:
        parts = [Part(self.find(s), self._steps(steps)) for s, steps in data.parts]
        write_mix(location, mix(parts, data.seed), self._gives_way(data, location))

    def _gives_way(self, data: Mix, location: Location) -> bool:
        """Whether a mix that is there may be replaced: it is of no more steps."""
        record = None if self.overwrite else recorded(location)
        if record is None:
            return True
        fewer = 0 < sum(_drawn(record).values()) <= sum(self._drawn_by(data))
        return record.seed == data.seed and fewer

    def _made_of(self, data: Source | Mix) -> list[Source]:
        """Sources that it begins with, or is drawn from."""
        if isinstance(data, Mix):
            return [source for source, _ in data.parts]
        return [data.first] if data.first and not self.small else []

    def _whole(self, data: Source | Mix, location: Location) -> bool:
        """Whether the dataset is there, as it is declared, with all its steps."""
        try:
            record = recorded(location)
        except DatasetError:
            if self.overwrite:
                return False
            raise
        if record is None or record.seed != data.seed:
            return False
        if isinstance(data, Mix):
            drawn = [self._location(source).id for source, _ in data.parts]
            return _drawn(record) == dict(zip(drawn, self._drawn_by(data), strict=True))
        return replace(data, steps=self._steps(data.steps)).made(record)

    def _deed(self, data: Source | Mix) -> str:
        if isinstance(data, Mix):
            names = ", ".join(source.name for source, _ in data.parts)
            return f"it is mixed of {names}"
        steps = self._steps(data.steps)
        return f"{steps} steps of {data.collector} in {data.task} are collected"

    def _location(self, data: Source | Mix) -> Location:
        if self.small is None:
            return locate(data.name)
        return locate(str((self.small / data.name.replace("/", "-")).resolve()))

    def _steps(self, steps: int) -> int:
        return min(steps, FEW) if self.small else max(1, round(self.scale * steps))

    def _drawn_by(self, data: Mix) -> list[int]:
        """Steps that are drawn from each source."""
        return [self._steps(steps) for _, steps in data.parts]

    def _declared(self, data: Data) -> Data:
        """The source that a word is short for, if it is one's, on the engine."""
        data = self.declared.get(data, data) if isinstance(data, str) else data
        return data if isinstance(data, str) else on_engine(data, self.engine)


def _drawn(record: Provenance) -> dict[str, int]:
    """Steps that were drawn from each source of a dataset, by the source's id."""
    return dict((record.recipe or {}).get("steps", {}))
