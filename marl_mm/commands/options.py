"""Options that several commands share."""

import re
from dataclasses import field, fields, make_dataclass
from typing import Annotated, Any

import tyro

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.envs.registry import LEVELS, TASKS
from marl_mm.runs.policies import AGENT
from marl_mm.workers import available_cores

CORES: Any = available_cores
"""Default of numbers of processes, for ``parser.command``."""


def _registered() -> str:
    """Names of tasks; those of a kind in three levels as KIND[-easy|-hard]-v0."""
    names = TASKS.names()
    levels = {n: {n.removesuffix("-v0") + end for end in LEVELS} for n in names}
    kinds = [n for n in names if levels[n] <= {*names}]
    told = {level for kind in kinds for level in levels[kind]}
    words = [
        n.replace("-v0", "[-easy|-hard]-v0") if n in kinds else n
        for n in names
        if n not in told
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


def config_of(name: str, settings: CollectorsSettings) -> Any:
    """Settings of the policy of a name, or None of one that is no collector's."""
    return getattr(settings, _attribute(name), None)


def _attribute(name: str) -> str:
    return "of_" + re.sub(r"\W", "_", name)
