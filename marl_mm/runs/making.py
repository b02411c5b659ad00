"""Datasets of declared sources: those that are there, and those that are made."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from marl_mm.datasets.dataset import Dataset, load_dataset, unpack
from marl_mm.datasets.location import SHIPPED, Location, locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.selection import Part, mix, write_selection
from marl_mm.errors import (
    DatasetError,
    OtherConfigError,
    UnknownDatasetError,
    UsageError,
)
from marl_mm.files import only_here
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.collecting import Collecting, collect_dataset, recorded
from marl_mm.runs.sources import Data, Mix, Source, on_engine
from marl_mm.sim.config import RECORDED_ENGINE, Engine
from marl_mm.workers import Executor

FEW = 30
"""Largest number of steps of a source in ``small``."""

Notify = Callable[[str], None]
"""Callback for messages to the user."""


def silence(text: str) -> None:
    """For callers who want no messages."""


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
    """Factory of progress bars."""

    declared: Mapping[str, Source | Mix] = field(default_factory=dict)
    """Declared sources by the word that an id is short for."""

    scale: float = 1.0
    """Share of the declared steps."""

    overwrite: bool = False
    """Replace what is damaged, of another declaration or of more steps."""

    plan: bool = False
    """Whether nothing is made: the dataset that ships stands in for what is missing."""

    engine: Engine | None = None
    """Engine of sources that name none."""

    def get(self, data: Data) -> Dataset:
        """A dataset; one that ships is unpacked, others are made, but for a plan."""
        data = self._declared(data)
        if not self.small and not isinstance(data, str):
            unpack(self._location(data))
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
                f"no dataset {data.name}: {self._in_words(data)} first"
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
                state = (
                    "is not complete, or is another one" if begun else "is not there"
                )
                self.notify(f"dataset {data.name} {state}: {self._in_words(data)}")
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
        collector = source.collector, source.config
        try:
            collection = collect_dataset(
                location, *collector, collecting, first, self.bar
            )
        except (UsageError, DatasetError) as error:
            if isinstance(error, OtherConfigError) and not self.overwrite:
                advice = f"marl-mm datasets delete {location.name} makes room"
                raise OtherConfigError(error.difference, advice) from error
            if not (begun and self.overwrite):
                raise
            anew = replace(collecting, resume=False, overwrite=True)
            collection = collect_dataset(location, *collector, anew, first, self.bar)
        if not collection.complete:
            raise KeyboardInterrupt(f"stopped in {source.name}; the same call goes on")

    def _mix(self, data: Mix, location: Location) -> None:
        parts = [Part(self.find(s), self._steps(steps)) for s, steps in data.parts]
        write_selection(
            location, mix(parts, data.seed), self._gives_way(data, location)
        )

    def _gives_way(self, data: Mix, location: Location) -> bool:
        """Whether a mix that is there may be replaced: it is of no more steps."""
        record = None if self.overwrite else recorded(location)
        if record is None:
            return True
        drawn = _drawn(record)
        fewer = 0 < sum(drawn.values()) <= sum(self._drawn_by(data))
        own = drawn.keys() == {self._location(source).id for source, _ in data.parts}
        return own and record.seed == data.seed and fewer

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
            same = dict(zip(drawn, self._drawn_by(data), strict=True))
            return _drawn(record) == same and all(
                self._is_drawn_from(source, record) for source, _ in data.parts
            )
        return replace(data, steps=self._steps(data.steps)).made(record)

    def _is_drawn_from(self, source: Source, mixed: Provenance) -> bool:
        """Whether a mix is of a source as it is now, or as it was before it went."""
        location = self._location(source)
        if recorded(location) is None:
            origin = mixed.origins.get(location.id)
            return origin is None or source.is_of(origin)
        drawn = {each["id"]: each["fingerprint"] for each in mixed.sources or ()}
        now = load_dataset(location).fingerprint
        return self._whole(source, location) and drawn.get(location.id) == now

    def _in_words(self, data: Source | Mix) -> str:
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
