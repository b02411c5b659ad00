"""Record of a run in its ``config.json``: algorithm, task, data, seed, settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, get_type_hints

from marl_mm.errors import CheckpointError
from marl_mm.received import check_kind
from marl_mm.sim.config import RECORDED_ENGINE


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Record of how a run is made."""

    algorithm: str
    """Registered name of the algorithm."""

    preset: str | None = None
    """Preset of the hyper-parameters; None where there are none."""

    seed: int
    """Seed of initial weights, batches and episodes."""

    task: str
    """Registered name of the task of the evaluations."""

    engine: str = RECORDED_ENGINE
    """Engine of the simulation; that of version 1 where none is recorded."""

    dataset: Mapping[str, str] | None = None
    """Id, path and fingerprint of the dataset; None without one."""

    packages: Mapping[str, str] = field(default_factory=dict)
    """Versions of the packages by name."""

    plugins: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the plug-ins that algorithm and task come from, by file name."""

    plugins_before: Sequence[Mapping[str, str]] = ()
    """Plug-ins of the run before it was resumed with others."""

    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of evaluation and schedule, and all hyper-parameters, by name."""

    def to_json(self) -> dict[str, Any]:
        """The record, flat, without plug-ins where there are none."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        rest = values.pop("settings")
        often = ("preset", "plugins", "plugins_before")
        kept = {name: v for name, v in values.items() if v or name not in often}
        return {**kept, **rest}

    @classmethod
    def from_json(cls, values: Mapping[str, Any], file: str) -> "RunConfig":
        """Record from ``to_json``; fields that version 1 lacks have their defaults.

        Args:
            values: Values of the record.
            file: Name of their file, for messages.

        Raises:
            CheckpointError: If a field is missing, or of another type.
        """
        names = {field.name for field in fields(cls)} - {"settings"}
        rest = {name: value for name, value in values.items() if name not in names}
        arguments = {name: value for name, value in values.items() if name in names}
        if missing := sorted({"algorithm", "seed", "task"} - arguments.keys()):
            raise CheckpointError(f"{file} is no run's: it lacks {', '.join(missing)}")
        record = cls(settings=rest, **arguments)
        for name, kind in get_type_hints(cls).items():
            check_kind(getattr(record, name), kind, f"{file}: {name}", CheckpointError)
        steps = rest.get("max_steps")
        check_kind(steps, int | None, f"{file}: max_steps", CheckpointError)
        return record

    def continued(
        self, plugins: Mapping[str, str], settings: Mapping[str, Any]
    ) -> "RunConfig":
        """The record of a run that goes on with these plug-ins and settings."""
        before = tuple(self.plugins_before)
        if dict(plugins) != dict(self.plugins):
            before = (*before, self.plugins)
        return replace(
            self,
            plugins=plugins,
            plugins_before=before,
            settings={**self.settings, **settings},
        )
