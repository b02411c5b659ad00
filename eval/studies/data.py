"""The datasets that studies learn from: what is missing is collected or mixed first."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from marl_mm.config_diff import as_json
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import SHIPPED, Location, locate
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.recipe import Part, mix, write_mix
from marl_mm.errors import UnknownDatasetError
from marl_mm.eval.studies import ours, paper
from marl_mm.eval.studies.study import Data, Mix, Source
from marl_mm.files import only_here
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs.collecting import Collecting, collect_dataset
from marl_mm.workers import Executor

FEW = 30
"""Steps of a source where hardly anything is trained."""

Tell = Callable[[str], None]
"""Called with what a reader should know while it happens."""


def silence(text: str) -> None:
    """For callers who want no messages."""


_DECLARED: tuple[Source | Mix, ...] = (*paper.GOOD, paper.PD_30K, *paper.MIXES)
_KNOWN = {source.name: source for source in (*_DECLARED, *ours.OTHER_TASKS)}
"""Declared sources by the word that an id is short for."""


@dataclass(frozen=True)
class Datasets:
    """Datasets of sources, in the datasets' root or, of few steps, in a folder."""

    small: Path | None = None
    """Folder of datasets of few steps; None: they have as many as declared."""

    workers: int = 1
    """Processes that collect."""

    executor: Executor = "local"
    """Processes of this machine, or of a Ray cluster."""

    tell: Tell = silence
    bar: Bar = silent_bar

    plan: bool = False
    """Whether nothing is made: the dataset that ships counts for what is missing."""

    def get(self, data: Data) -> Dataset:
        """A dataset; what is missing of it is made, but for a plan."""
        if not self.plan:
            return self.make(data)
        try:
            return self.find(data)
        except UnknownDatasetError as error:
            self.tell(f"counted as if learnt from good-5k: {error}")
            return load_dataset(SHIPPED)

    def find(self, data: Data) -> Dataset:
        """A dataset that is there and whole; an UnknownDatasetError if it is not."""
        data = _declared(data)
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
            UnknownDatasetError: If there is none, and nobody knows how to make it.
            OtherConfigError: If another collection has its name.
            KeyboardInterrupt: After Ctrl-C; the same call goes on.
        """
        data = _declared(data)
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
                self.tell(f"dataset {data.name} {state}: {self._deed(data)}")
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
            workers=1 if self.small else self.workers,  # few episodes are over at once
            executor=self.executor,
            resume=begun,
        )
        first = next(map(self._location, self._made_of(source)), None)
        collection = collect_dataset(
            location, source.collector, source.config, collecting, first, self.bar
        )
        if not collection.complete:
            raise KeyboardInterrupt(f"stopped in {source.name}; the same call goes on")

    def _mix(self, data: Mix, location: Location) -> None:
        parts = [Part(self.find(s), self._steps(steps)) for s, steps in data.parts]
        write_mix(location, mix(parts, data.seed))

    def _made_of(self, data: Source | Mix) -> list[Source]:
        """Sources that it begins with, or is drawn from."""
        if isinstance(data, Mix):
            return [source for source, _ in data.parts]
        return [data.first] if data.first and not self.small else []

    def _whole(self, data: Source | Mix, location: Location) -> bool:
        """Whether the dataset is there, as it is declared, with all its steps."""
        if not location.folder.exists():
            return False
        known = Provenance.from_json(read_metadata(location)["marl_mm"])
        if isinstance(data, Mix):
            steps = [self._steps(steps) for _, steps in data.parts]
            drawn = (known.recipe or {}).get("steps", {})
            return known.seed == data.seed and [*drawn.values()] == steps
        config = as_json(dict(known.collector_config or {}))
        theirs = known.task, known.collector, config, known.seed, known.steps_asked
        config, steps_asked = as_json(asdict(data.config)), self._steps(data.steps)
        mine = data.task, data.collector, config, data.seed, steps_asked
        return known.complete and theirs == mine

    def _deed(self, data: Source | Mix) -> str:
        if isinstance(data, Mix):
            return (
                f"it is mixed of {', '.join(source.name for source, _ in data.parts)}"
            )
        steps = self._steps(data.steps)
        return f"{steps} steps of {data.collector} in {data.task} are collected"

    def _location(self, data: Source | Mix) -> Location:
        if self.small is None:
            return locate(data.name)
        return locate(str((self.small / data.name.replace("/", "-")).resolve()))

    def _steps(self, steps: int) -> int:
        return min(steps, FEW) if self.small else steps


def _declared(data: Data) -> Data:
    """The source that a word is short for, if it is a declared one's."""
    return _KNOWN.get(data, data) if isinstance(data, str) else data
