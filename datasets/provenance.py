"""Provenance of episodes, as datasets record it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, cast, get_type_hints

from marl_mm.episode import IMPORTED
from marl_mm.errors import DatasetError
from marl_mm.received import check_kind
from marl_mm.registry import NAME
from marl_mm.sim.config import RECORDED_ENGINE, Engine
from marl_mm.versions import engine_text

_MOST_STEPS = 1_000_000_000
"""Largest number of steps per episode in a dataset's record."""


@dataclass(frozen=True, kw_only=True)
class Origin:
    """One collection: the task, and the collector that acted in it."""

    task: str | None = None
    """Registered name of the task; None in files without one."""

    overrides: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the task that were replaced."""

    config: Mapping[str, Any] = field(default_factory=dict)
    """All fields of the task."""

    collector: str | None = None
    """Name of the collector; None for imported episodes."""

    collector_config: Mapping[str, Any] | None = None
    """Settings of the collector."""

    seed: int | None = None
    """Seed of the collection."""

    weights: str | None = None
    """Fingerprint of the learnt agent that acted; None without one."""

    file: str | None = None
    """Name of the file that imported episodes come from."""

    plugins: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the plug-ins that task and collector come from, by file name."""

    def to_json(self) -> dict[str, Any]:
        """The record as JSON values, without empty fields."""
        return _filled(self)


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Provenance of a whole dataset."""

    task: str
    """Registered name of the task whose rewards these are."""

    overrides: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the task that were replaced."""

    collector: str
    """Name of the collector, or of the recipe by which it was made from others."""

    seed: int | None = None
    """Seed of the collection or of the draw."""

    collector_config: Mapping[str, Any] | None = None
    """Settings of the collector."""

    config: Mapping[str, Any] = field(default_factory=dict)
    """All fields of the task."""

    weights: str | None = None
    """Fingerprint of the learnt agent that acted; None without one."""

    plugins: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the plug-ins that task and collector come from, by file name."""

    origins: Mapping[str, Origin] = field(default_factory=dict)
    """Collections of the episodes, by the ids of their datasets. If it is empty, all
    episodes were collected for this dataset."""

    recipe: Mapping[str, Any] | None = None
    """Recipe by which the episodes were chosen from others; None of collections."""

    sources: Sequence[Mapping[str, str]] | None = None
    """Ids, engines and fingerprints of the datasets that the episodes were chosen
    from."""

    packages: Mapping[str, str] | None = None
    """Versions of the packages that made it; None stands for those of now."""

    attempts: int | None = None
    """Number of episodes run, kept or not; None if it was not counted."""

    steps_asked: int | None = None
    """Number of steps asked for; None if it was not recorded."""

    complete: bool = True
    """Whether the collection was not stopped early."""

    @classmethod
    def collected(cls, origin: Origin, **more: Any) -> "Provenance":
        """Provenance of a dataset of one collection."""
        if origin.task is None or origin.collector is None:
            raise DatasetError("a collection has a task and a collector")
        return cls(**{name: getattr(origin, name) for name in _SHARED}, **more)

    @property
    def engine(self) -> str | None:
        """Engine of the episodes; None where the record names none."""
        records: list[Provenance | Origin] = [self, *self.origins.values()]
        for record in records:
            for replaced in (record.overrides, record.config):
                simulation = replaced.get("simulation")
                if isinstance(simulation, Mapping) and "engine" in simulation:
                    return str(simulation["engine"])
        return None

    @property
    def engine_text(self) -> str:
        """Engine of the episodes, with its version where it is known and one."""
        engine = cast(Engine, self.engine or RECORDED_ENGINE)
        if self.sources:
            texts = {source.get("engine", engine) for source in self.sources}
            return texts.pop() if len(texts) == 1 else engine
        known = self.collector != IMPORTED and not self.recipe
        packages = (self.packages or {}) if known else {}
        return engine_text(engine, packages)

    @property
    def own_origin(self) -> Origin:
        """The record of the collection, of datasets of one collection."""
        return Origin(**{name: getattr(self, name) for name in _SHARED})

    def to_json(self, dataset_id: str) -> dict[str, Any]:
        """The record for the metadata of a dataset of this id."""
        origins = self.origins or {dataset_id: self.own_origin}
        return {
            **_filled(self),
            "seed": self.seed,
            "attempts": self.attempts,
            "complete": self.complete,
            "origins": {name: origin.to_json() for name, origin in origins.items()},
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "Provenance":
        """The provenance in a dataset's metadata.

        Raises:
            DatasetError: If a required field is missing, or of another type.
        """
        names = {item.name for item in fields(cls)} & values.keys()
        filled = {name: values[name] for name in names}
        kind = dict[str, dict[str, Any]]
        origins = values.get("origins", {})
        check_kind(origins, kind, "metadata.json: origins", DatasetError)
        try:
            of_origin = {item.name for item in fields(Origin)}
            filled["origins"] = {
                str(name): Origin(**{k: v for k, v in about.items() if k in of_origin})
                for name, about in origins.items()
            }
            provenance = cls(**filled)
        except (TypeError, AttributeError) as error:
            raise DatasetError(f"metadata.json: {error}") from error
        records: list[Origin | Provenance] = [provenance, *provenance.origins.values()]
        for record in records:
            for name, kind in get_type_hints(type(record)).items():
                where = f"metadata.json: {name}"
                check_kind(getattr(record, name), kind, where, DatasetError)
            _check_task(record)
        return provenance


def _check_task(record: Origin | Provenance) -> None:
    """Raise a DatasetError for a task that cannot have its name, steps or engine."""
    if record.task is not None and not NAME.fullmatch(record.task):
        raise DatasetError(
            f"metadata.json: task is {record.task!r:.60}, expected a letter and then "
            "letters, digits, '-', '_' and '.'"
        )
    steps = record.overrides.get("max_steps")
    if steps is not None and (type(steps) is not int or not 1 <= steps <= _MOST_STEPS):
        raise DatasetError(
            f"metadata.json: max_steps is {steps!r:.60}, expected an integer from 1 to "
            f"{_MOST_STEPS:,}"
        )
    for replaced in (record.overrides, record.config):
        simulation = replaced.get("simulation", {})
        where = "metadata.json: simulation"
        check_kind(simulation, dict[str, Any], where, DatasetError)
        engine = simulation.get("engine", RECORDED_ENGINE)
        check_kind(engine, Engine, f"{where}.engine", DatasetError)


_SHARED = {item.name for item in fields(Provenance)} & {
    item.name for item in fields(Origin)
}


def _filled(record: Origin | Provenance) -> dict[str, Any]:
    """Fields of a record that are not empty."""
    values = {item.name: getattr(record, item.name) for item in fields(record)}
    return {
        name: value
        for name, value in values.items()
        if name == "overrides" or not (value is None or value == {} or value == [])
    }
