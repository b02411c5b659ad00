"""Datasets as declarations: a collector and a task, or a mix of such."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from marl_mm import plugins
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.config_diff import as_json
from marl_mm.datasets.provenance import Origin, Provenance
from marl_mm.declared import as_record, plain
from marl_mm.envs.registry import DEFAULT, TASKS, config_dict, make_task
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.runs.settings import check_positive, check_seed, with_settings
from marl_mm.sim.config import (
    RECORDED_ENGINE,
    Engine,
    as_recorded,
    default_engine,
    engine_of,
    engine_overrides,
)


def task_folder(task: str) -> str:
    """Folder of a task's datasets, such as quiet-zone-hard of QuietZone-hard-v0."""
    name = task.removesuffix("-v0")
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).lower()
    name = re.sub(r"[^a-z0-9_-]", "-", name)
    return name if len(name) > 1 else f"{name}-task"  # as ids have folders


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
        if not isinstance(self.settings, Mapping):
            raise UsageError(
                f"settings is {self.settings!r:.60}, expected values by name"
            )
        if not isinstance(self.first, Source | None):
            raise UsageError(f"first is {self.first!r:.60}, expected a Source")
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
        longest = COLLECTORS.get(self.collector).max_steps
        longest = longest or make_task(self.task).max_steps
        return (
            record.complete
            and self.is_of(record)
            and record.steps_asked == self.steps
            and record.overrides.get("max_steps", longest) == longest
            and self._acts_alike(record)
        )

    def is_of(self, record: Provenance | Origin) -> bool:
        """Whether a collection's task, collector, seed and engine are the source's."""
        config = as_json(as_record(self.config))
        engine = self.engine or RECORDED_ENGINE
        actual = as_json(dict(record.collector_config or {}))
        return (self.task, self.collector, config, engine, self.seed) == (
            *(record.task, record.collector, actual, engine_of(record.overrides)),
            record.seed,
        )

    def _acts_alike(self, record: Provenance) -> bool:
        """Whether task, plug-ins and weights are those that a dataset was made with."""
        task = make_task(self.task, as_recorded(record.overrides))
        if _differ(record.config, as_json(config_dict(task))):
            return False
        origins = COLLECTORS.origin(self.collector), TASKS.origin(self.task)
        if dict(record.plugins) != plugins.record(*origins):
            return False
        if record.weights is None:
            return True
        try:
            policy = COLLECTORS.get(self.collector).policy(self.config, task)
        except MarlMmError:  # the agent is gone, its data are there
            return True
        return bool(policy.describe().get("weights") == record.weights)


def _differ(begun: Mapping[str, Any], now: Mapping[str, Any]) -> bool:
    """Whether settings that both records have differ; older ones lack some."""
    for key in begun.keys() & now.keys():
        before, value = begun[key], now[key]
        nested = isinstance(before, Mapping) and isinstance(value, Mapping)
        if _differ(before, value) if nested else before != value:
            return True
    return False


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
        try:
            parts = tuple((source, plain(steps)) for source, steps in self.parts)
        except (TypeError, ValueError):
            parts = ()
        if not parts or not all(isinstance(source, Source) for source, _ in parts):
            raise UsageError(
                f"mix {self.name!r} is of {self.parts!r:.80}, expected pairs of a "
                "Source and steps"
            )
        for _, steps in parts:
            check_positive(steps=steps)
        object.__setattr__(self, "parts", parts)
        object.__setattr__(self, "seed", plain(self.seed))
        check_seed(self.seed)
        if len(engines := {source.engine for source, _ in self.parts}) > 1:
            names = " and ".join(sorted(str(engine) for engine in engines))
            raise UsageError(
                f"mix {self.name!r} has sources with engine {names}, expected one in a "
                "mix: name the same in all"
            )

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
