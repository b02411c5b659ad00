"""Collectors by name: who acts, and which of the episodes a dataset keeps."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from marl_mm.declared import defaults
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


@dataclass(frozen=True, kw_only=True)
class Collector:
    """A way to collect episodes.

    Raises:
        UsageError: If a setting of its config has no default.
    """

    about: str
    """What it does, in a sentence for helps."""

    config: type
    """Frozen dataclass of its settings, all with defaults."""

    policy: Callable[[Any, Task], Policy]
    """Makes the policy of a config for a task; it raises a ``UsageError`` for what
    makes no sense there."""

    keeps: Callable[[Episode], bool] = everything
    """Whether a dataset keeps an episode."""

    max_steps: int | None = None
    """Steps of an episode where nobody says another number; None: the task's."""

    dataset: str | None = None
    """Name of its datasets where nobody says another; None: the collector's."""

    def __post_init__(self) -> None:
        defaults(self.config)


COLLECTORS: Registry[Collector] = Registry(
    "collector",
    [
        f"marl_mm.collectors.{name}"
        for name in ("pretrained", "pd", "medium", "random", "scripted")
    ],
    of=Collector,
    taken=("paper",),  # marl-mm collect paper: all of the paper's datasets
)
"""Collectors that there are."""
