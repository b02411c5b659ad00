"""What studies are made of: sources, settings that learn from them, and evaluations."""

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from marl_mm.algorithms.fine_tuning import FineTuning
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, preset
from marl_mm.declared import like
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.errors import UsageError
from marl_mm.runs.settings import with_settings
from marl_mm.runs.sources import Data
from marl_mm.sim.config import Engine

_NONE: Mapping[str, Any] = MappingProxyType({})


def check_name(name: str) -> None:
    """Raise a UsageError for a name that rows and files cannot have."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][\w.-]*", name):
        raise UsageError(
            f"name is {name!r:.40}, expected a letter and then letters, digits, '-', "
            "'_' or '.'"
        )


@dataclass(frozen=True)
class Online:
    """A source: episodes of the learner's own."""

    task: str = DEFAULT
    """Registered name of the task."""

    demonstrations: Data | None = None
    """Dataset whose episodes are replayed too."""

    name: str = ""
    """Name of the source in rows; default made of the fields above."""

    def __post_init__(self) -> None:
        """Refuse an unknown task, and make the default name."""
        make_task(self.task)
        if not isinstance(self.demonstrations, Data | None):
            raise UsageError(
                f"demonstrations is {self.demonstrations!r:.40}, expected a dataset's "
                "name, a Source or a Mix"
            )
        if not self.name:
            beside = (
                () if self.demonstrations is None else (name_of(self.demonstrations),)
            )
            object.__setattr__(self, "name", "-".join(("online", self.task, *beside)))


def name_of(source: Data | Online) -> str:
    """Name of a source in rows and tables."""
    return source if isinstance(source, str) else source.name


@dataclass(frozen=True)
class Setting:
    """An algorithm with its hyper-parameters and evaluations."""

    name: str
    """Name of the setting's folder; no two settings of a study share one."""

    about: str
    """Description in tables."""

    algorithm: str = "td3-bc"
    """Registered name of the algorithm."""

    preset: str = TUNED
    """Preset of hyper-parameters that the changes are made to."""

    changes: Mapping[str, Any] = field(default_factory=dict)
    """Hyper-parameters that replace the preset's."""

    goals: int = 200
    """Number of goals of each evaluation of a trained policy."""

    curve_every: int = 5_000
    """Updates between points of the learning curve, of offline runs."""

    curve_goals: int | None = None
    """Number of goals of each of these points; default 20 offline and 50 online."""

    task: str | None = None
    """Registered name of the task of the evaluations, of offline runs; default the
    dataset's."""

    max_steps: int | None = None
    """Steps of an episode; default the task's."""

    measured: tuple[str, ...] | None = None
    """Columns of evaluated goals that rows keep beside the success; default all."""

    fine_tuning: FineTuning = field(default_factory=FineTuning)
    """Settings of own episodes after the offline updates; default none."""

    library: Literal["marl_mm", "sb3"] = "marl_mm"
    """Implementation: ours, or Stable-Baselines3's DDPG + HER."""

    def __post_init__(self) -> None:
        """Refuse settings that cannot be run."""
        check_name(self.name)
        if not isinstance(self.changes, Mapping):
            raise UsageError(
                f"changes is {self.changes!r:.40}, expected values by name"
            )
        for name, usual in (("goals", 200), ("curve_every", 5_000)):
            like(getattr(self, name), usual, name)
        if self.goals < 2 or self.goals % 2:
            raise UsageError(f"goals is {self.goals}, expected 2, 4, 6 ...: each way")
        of_curve = self.curve_goals
        if of_curve is not None and like(of_curve, 20, "curve_goals") < 1:
            raise UsageError(f"curve_goals is {of_curve}, expected >= 1")
        if self.measured is not None and "return" not in self.measured:
            raise UsageError(
                f"measured is {self.measured}, expected 'return' in it: tables have it"
            )
        if self.library not in ("marl_mm", "sb3"):
            raise UsageError(
                f"library is {self.library!r:.40}, expected one of marl_mm, sb3"
            )
        if self.library == "sb3" and self.algorithm != "ddpg-her":
            raise UsageError(
                f"library is 'sb3', whose algorithm is ddpg-her, not {self.algorithm}"
            )
        _ = self.config

    @property
    def config(self) -> Any:
        """Hyper-parameters."""
        default = preset(self.algorithm, self.preset)
        try:
            return with_settings(self.algorithm, default, self.changes)
        except UsageError as error:
            raise UsageError(f"setting {self.name!r}: {error}") from None

    @property
    def online(self) -> bool:
        """Whether the algorithm learns from episodes of its own."""
        return ALGORITHMS.get(self.algorithm).online


def setting_of(
    name: str,
    algorithm: str,
    updates: int,
    changes: Mapping[str, Any] = _NONE,
    **more: Any,
) -> Setting:
    """Setting of a study of several algorithms: the tuned preset, with its title.

    Args:
        name: Name of the setting's folder.
        algorithm: Registered name of the algorithm.
        updates: Number of updates.
        changes: Other hyper-parameters that replace the preset's.
        **more: Other fields of the setting.
    """
    title = ALGORITHMS.get(algorithm).title or algorithm
    changes = {**changes, "updates": updates}
    return Setting(name, title, algorithm, changes=changes, **more)


@dataclass(frozen=True)
class Probe:
    """An evaluation of a trained run."""

    name: str
    """Name in rows, and of the evaluation's file in the run."""

    about: str
    """Description in tables."""

    checkpoint: Literal["last", "best"] = "last"
    """Checkpoint that is evaluated."""

    overrides: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the task that are replaced."""

    alpha: float | None = None
    """Fixed alpha that replaces the policy's; None: the policy's own."""

    task: str | None = None
    """Registered name of the task; None: the one that the run was trained for."""

    def __post_init__(self) -> None:
        """Refuse settings that cannot be evaluated."""
        check_name(self.name)
        if self.checkpoint not in ("last", "best"):
            raise UsageError(
                f"checkpoint is {self.checkpoint!r}, expected one of last, best"
            )
        if self.alpha is not None and not 0 <= like(self.alpha, 0.5, "alpha") <= 1:
            raise UsageError(f"alpha is {self.alpha}, expected a number in [0, 1]")
        make_task(self.task or DEFAULT, self.overrides)  # raises

    @property
    def engine(self) -> Engine | None:
        """Engine that the overrides name, if they do."""
        engine: Engine | None = self.overrides.get("simulation", {}).get("engine")
        return engine

    @property
    def way(self) -> dict[str, Any]:
        """The evaluation's settings without its name."""
        values = asdict(self)
        elsewhere = () if self.task is None else ("task",)  # older records have none
        names = ("checkpoint", "overrides", "alpha", *elsewhere)
        return {key: values[key] for key in names}

    def file(self, run: Path) -> Path:
        """File of the evaluation in a run folder."""
        if self.name == BEST.name and self != BEST:  # not the training's own
            return run / f"eval_probe_{self.name}.json"
        return run / ("eval.json" if self == LAST else f"eval_{self.name}.json")


LAST = Probe("last", "at the end")
BEST = Probe("best", "at the best checkpoint", checkpoint="best")
