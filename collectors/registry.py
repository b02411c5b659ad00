"""The registry of collectors: the policy that acts, and the episodes that are kept."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from marl_mm.declared import defaults, refuse_taken
from marl_mm.envs.task import Task
from marl_mm.episode import Episode
from marl_mm.policy import Policy
from marl_mm.registry import Registry


def successes(episode: Episode) -> bool:
    """Keep episodes that reached their goal."""
    return episode.success


def everything(episode: Episode) -> bool:
    """Keep all episodes."""
    return True


COLLECTING = (
    *("collector", "task", "dataset", "config", "progress"),
    *("steps", "seed", "workers", "executor", "max_steps", "engine"),
    *("resume", "overwrite"),
)
"""Names of what a collection is asked for beside a collector's settings."""


@dataclass(frozen=True, kw_only=True)
class Collector:
    """A way to collect episodes.

    Raises:
        UsageError: If a setting of its config has no default.
    """

    about: str
    """Sentence for help texts that says what the collector does."""

    config: type
    """Frozen dataclass of the collector's settings, all with defaults."""

    policy: Callable[[Any, Task], Policy]
    """Function of a config and a task that returns the policy; it raises a
    ``UsageError`` for settings that make no sense in the task."""

    keeps: Callable[[Episode], bool] = everything
    """Function that says whether a dataset keeps an episode."""

    max_steps: int | None = None
    """Default number of steps of an episode; None for the task's."""

    dataset: str | None = None
    """Default name of the datasets; None for the collector's name."""

    def __post_init__(self) -> None:
        refuse_taken(self.config, defaults(self.config), COLLECTING)


COLLECTORS: Registry[Collector] = Registry(
    "collector",
    [
        f"marl_mm.collectors.{name}"
        for name in ("pretrained", "pd", "medium", "random", "scripted", "varied")
    ],
    of=Collector,
    taken=("paper",),  # marl-mm collect paper: all of the paper's datasets
)
"""All collectors by name."""
