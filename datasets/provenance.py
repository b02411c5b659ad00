"""Where episodes come from: typed records of what datasets say of themselves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from marl_mm.errors import DatasetError


@dataclass(frozen=True, kw_only=True)
class Origin:
    """One collection: the task, and who acted in it."""

    task: str | None = None
    """Registered name of the task; None in files that do not say."""

    overrides: Mapping[str, Any] = field(default_factory=dict)
    """Numbers of the task that were replaced."""

    config: Mapping[str, Any] = field(default_factory=dict)
    """All numbers of the task."""

    collector: str | None = None
    """Name of the collector; None of imported episodes."""

    collector_config: Mapping[str, Any] | None = None
    """Settings of the collector."""

    seed: int | None = None
    """Seed of the collection."""

    weights: str | None = None
    """Fingerprint of the agent that acted, if one did."""

    file: str | None = None
    """Name of the file that imported episodes come from."""

    plugins: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the plug-ins that task and collector come from, by file name."""

    def to_json(self) -> dict[str, Any]:
        """The record without what it does not know."""
        return _told(self)


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """What a dataset says of its making."""

    task: str
    """Registered name of the task whose rewards these are."""

    overrides: Mapping[str, Any] = field(default_factory=dict)
    """Numbers of the task that were replaced."""

    collector: str
    """Name of the collector, or of the way in which the dataset was made of others."""

    seed: int | None = None
    """Seed of the collection or of the draw."""

    collector_config: Mapping[str, Any] | None = None
    """Settings of the collector."""

    config: Mapping[str, Any] = field(default_factory=dict)
    """All numbers of the task."""

    weights: str | None = None
    """Fingerprint of the agent that acted, if one did."""

    plugins: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the plug-ins that task and collector come from, by file name."""

    origins: Mapping[str, Origin] = field(default_factory=dict)
    """Collections that the episodes come from, by the ids of their datasets; left out,
    they were all collected for this one."""

    recipe: Mapping[str, Any] | None = None
    """How the episodes were chosen from others."""

    sources: Sequence[Mapping[str, str]] | None = None
    """Ids and fingerprints of the datasets that they were chosen from."""

    packages: Mapping[str, str] | None = None
    """Versions of what made it; left out, those of now."""

    attempts: int | None = None
    """Episodes run, kept or not; None where nobody counted."""

    steps_asked: int | None = None
    """Steps asked for."""

    complete: bool = True
    """Whether the collection was not stopped early."""

    @classmethod
    def collected(cls, origin: Origin, **more: Any) -> "Provenance":
        """Of one collection."""
        if origin.task is None or origin.collector is None:
            raise DatasetError("a collection has a task and a collector")
        return cls(**{name: getattr(origin, name) for name in _SHARED}, **more)

    @property
    def own_origin(self) -> Origin:
        """The collection, if the dataset is of one."""
        return Origin(**{name: getattr(self, name) for name in _SHARED})

    def to_json(self, dataset_id: str) -> dict[str, Any]:
        """The record for the metadata of a dataset of this id."""
        origins = self.origins or {dataset_id: self.own_origin}
        return {
            **_told(self),
            "seed": self.seed,
            "attempts": self.attempts,
            "complete": self.complete,
            "origins": {name: one.to_json() for name, one in origins.items()},
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "Provenance":
        """What a dataset's metadata say.

        Raises:
            DatasetError: If they lack what every dataset says, or say it otherwise.
        """
        known = {one.name for one in fields(cls)} & values.keys()
        told = {name: values[name] for name in known}
        try:
            of_origin = {one.name for one in fields(Origin)}
            told["origins"] = {
                str(name): Origin(**{k: v for k, v in about.items() if k in of_origin})
                for name, about in values.get("origins", {}).items()
            }
            found = cls(**told)
        except (TypeError, AttributeError) as error:
            raise DatasetError(f"metadata.json: {error}") from error
        if not isinstance(found.task, str) or not isinstance(found.overrides, Mapping):
            raise DatasetError(
                f"metadata.json: task is {found.task!r} and overrides "
                f"{found.overrides!r}, expected a name and a mapping"
            )
        return found


_SHARED = {one.name for one in fields(Provenance)} & {
    one.name for one in fields(Origin)
}


def _told(record: Origin | Provenance) -> dict[str, Any]:
    """A record's fields that hold something."""
    values = {one.name: getattr(record, one.name) for one in fields(record)}
    return {
        name: value
        for name, value in values.items()
        if name == "overrides" or value not in (None, {}, [])
    }
