"""Registry of the algorithms: learner, source and presets by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from importlib import import_module
from typing import Any

from marl_mm.algorithms.run_config import RunConfig
from marl_mm.declared import check_settings
from marl_mm.errors import UsageError
from marl_mm.registry import Registry

TUNED = "tuned"
"""Preset of the defaults."""

PAPER = "paper"
"""Preset of the source paper's tables."""

BENCHMARK = "benchmark"
"""Preset that the tuning chose on data of coordination tasks, as in the benchmark."""


_NEEDED = {
    False: ("updates", "precision"),
    True: ("episodes", "episodes_per_cycle", "updates_per_episode"),
}
"""Hyper-parameters that every run has, offline and online."""


@dataclass(frozen=True, kw_only=True)
class Algorithm:
    """A way to learn.

    Raises:
        UsageError: If it has no tuned preset, or hyper-parameters lack what every run
            needs, a default or a name of their own.
    """

    about: str
    """Description in a sentence, for helps."""

    source: str
    """Source: author and year, or section of the source paper."""

    learner: Callable[..., Any]
    """Constructor of the learner. Offline it takes a config, episodes, a judge, seeds
    and a device, and makes an ``OfflineAlgorithm``; online a config, a judge, a seed,
    demonstrations and a layout, and makes an ``OnlineAlgorithm``."""

    presets: Mapping[str, Any]
    """Hyper-parameters by preset, frozen dataclasses; ``TUNED`` is the default."""

    title: str = ""
    """Name as papers write it; default the registered name."""

    loss: str = ""
    """Loss of the actors, in a line."""

    advice: str = ""
    """When to use it and when not, in a sentence or two."""

    departs: str = ""
    """What departs from the source beside numbers, and why, in a sentence or two."""

    online: bool = False
    """Whether it learns from its own episodes instead of a dataset."""

    check: Callable[[Any], None] = lambda config: None
    """Check that raises a ``UsageError`` for hyper-parameters of another algorithm."""

    @property
    def learns(self) -> str:
        """What it learns from, in words."""
        if self.online:
            return "online"
        beside = getattr(self.presets[TUNED], "updates", 1) == 0
        return "online, beside a dataset" if beside else "from a dataset"

    def __post_init__(self) -> None:
        if TUNED not in self.presets:
            raise UsageError(f"an algorithm has no preset {TUNED!r}: {self.about!r}")
        recorded = [field.name for field in fields(RunConfig)]
        for config in self.presets.values():
            check_settings(config, _NEEDED[self.online], recorded)


@dataclass(frozen=True)
class Imported:
    """A learner of a module that is imported when the first one is made.

    Hyper-parameters are then at hand without torch, which takes a second.
    """

    learner: str
    """Module and name, as in "package.module:Name"."""

    def __call__(self, *arguments: Any) -> Any:
        """Make the learner."""
        module, name = self.learner.split(":")
        return getattr(import_module(module), name)(*arguments)

    @property
    def file(self) -> str:
        """Name of the module's file."""
        return f"{self.learner.split(':')[0].rpartition('.')[2]}.py"


ALGORITHMS: Registry[Algorithm] = Registry(
    "algorithm",
    [
        f"marl_mm.algorithms.{name}_config"
        for name in (
            *("mabc", "flow_bc", "td3_bc", "matd3_bc", "iql", "rebrac"),
            *("cfcql", "omar", "maicq", "fql", "mac_flow", "best_of_n", "q_chunking"),
            *("cal_ql", "rlpd"),
            *("ddpg", "maddpg"),
        )
    ],
    of=Algorithm,
)
"""Registered algorithms."""


def names(online: bool) -> tuple[str, ...]:
    """Names of the algorithms that learn online, or of those that learn offline."""
    return tuple(n for n, algorithm in ALGORITHMS.items() if algorithm.online == online)


def preset(algorithm: str, name: str = TUNED) -> Any:
    """An algorithm's hyper-parameters.

    Args:
        algorithm: Name of a registered algorithm.
        name: Name of one of its presets.

    Raises:
        UsageError: If there is no such algorithm or preset.
    """
    presets = ALGORITHMS.get(algorithm).presets
    if name not in presets:
        raise UsageError(
            f"`preset` is {name!r}, expected one of {', '.join(presets)}: {algorithm} "
            "has no other"
        )
    return presets[name]
