"""What a run is made of: the record in its ``config.json``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from marl_mm.errors import CheckpointError


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """What a run is made of."""

    algorithm: str
    """Registered name of the algorithm."""

    preset: str | None = None
    """Preset that the hyper-parameters started from; None where there are none."""

    seed: int
    """Seed of initial weights, batches and episodes."""

    task: str
    """Registered name of the task that is evaluated in."""

    dataset: Mapping[str, str] | None = None
    """Id, path and fingerprint of what is learnt from; None: of nobody's episodes."""

    packages: Mapping[str, str] = field(default_factory=dict)
    """Versions of what the run is made with."""

    plugins: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the plug-ins that algorithm and task come from, by file name."""

    plugins_before: Sequence[Mapping[str, str]] = ()
    """Those that the run went on without."""

    settings: Mapping[str, Any] = field(default_factory=dict)
    """Numbers of evaluation and schedule, and all hyper-parameters, by name."""

    def to_json(self) -> dict[str, Any]:
        """The record, flat, without plug-ins where there are none."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        rest = values.pop("settings")
        often = ("preset", "plugins", "plugins_before")
        kept = {name: v for name, v in values.items() if v or name not in often}
        return {**kept, **rest}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "RunConfig":
        """Back from ``to_json``; what version 1 did not write has its default.

        Raises:
            CheckpointError: If it does not say what every run says.
        """
        known = {one.name for one in fields(cls)} - {"settings"}
        rest = {name: value for name, value in values.items() if name not in known}
        told = {name: value for name, value in values.items() if name in known}
        try:
            return cls(settings=rest, **told)
        except TypeError as error:
            raise CheckpointError(f"config.json: {error}") from error

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
