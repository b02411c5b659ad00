"""Options that several commands share."""

import re
from collections.abc import Sequence
from dataclasses import field, fields, make_dataclass
from typing import Annotated, Any

import tyro

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.envs.registry import TASKS, kind_of
from marl_mm.errors import UsageError
from marl_mm.runs.policies import AGENT
from marl_mm.workers import available_cores

CORES: Any = available_cores
"""Default of numbers of processes, for ``parser.command``."""


def _registered() -> str:
    """Names of tasks; those of a kind in several levels as KIND[-easy|-hard]-v0."""
    levels: dict[str, list[str]] = {}
    for name in TASKS.names():
        kind = levels.setdefault(kind_of(name), [])
        if kind_of(name) != name:
            kind.append(name[name.index("-") :].removesuffix("-v0"))
    words = [
        kind.replace("-v0", f"[{'|'.join(ends)}]-v0") if ends else kind
        for kind, ends in levels.items()
    ]
    return " or ".join((", ".join(words[:-1]), words[-1]))


def task_help(text: str) -> Any:
    """Help of an option with a task's name; {} stands for the registered names."""
    return tyro.conf.arg(help=text.format(_registered()))


OwnTask = Annotated[str | None, task_help("{}; default the runs' own, or Reach-v0.")]
"""A task, by default that of policies."""


def _collectors_settings() -> type:
    settings = [
        (
            _attribute(name),
            Annotated[collector.config, tyro.conf.arg(name=name)],
            field(default_factory=collector.config),
        )
        for name, collector in COLLECTORS.items()
        if name != AGENT and fields(collector.config)
    ]
    return make_dataclass("Settings", settings, frozen=True)


CollectorsSettings = Annotated[
    Any, tyro.conf.arg(name="", constructor_factory=_collectors_settings)
]
"""Settings of every collector's policy, as options that begin with its name."""


def configs_of(policies: Sequence[str], settings: CollectorsSettings) -> list[Any]:
    """Settings of policies by name, or None of one that is no collector's.

    Raises:
        UsageError: If there are some of another collector.
    """
    for name, collector in COLLECTORS.items():
        given = getattr(settings, _attribute(name), None)
        if given not in (None, collector.config()) and name not in policies:
            raise UsageError(
                f"--{name}.* have no effect: {name} is not among the policies, "
                f"{', '.join(policies)}"
            )
    return [getattr(settings, _attribute(name), None) for name in policies]


def _attribute(name: str) -> str:
    return "of_" + re.sub(r"\W", "_", name)
