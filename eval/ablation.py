"""What an ablation is: settings on datasets, and how their runs are evaluated."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, get_type_hints

from typeguard import TypeCheckError, check_type

from marl_mm.algorithms.registry import TUNED, names, preset
from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError


def _check_name(name: str) -> None:
    if not re.fullmatch(r"[A-Za-z][\w.-]*", name):
        raise UsageError(
            f"name is {name!r}, expected a letter and then letters, digits, '-', '_' "
            "or '.'"
        )


def _check_choice(what: str, value: str, choices: Sequence[str]) -> None:
    if value not in choices:
        raise UsageError(f"{what} is {value!r}, expected one of {', '.join(choices)}")


def _check_once(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"{name!r} stands there twice, expected once")


@dataclass(frozen=True)
class Setting:
    """One way to learn from a dataset."""

    name: str
    """Of its folder; no two settings share one."""

    about: str
    """In tables."""

    algorithm: str = "td3-bc"
    preset: str = TUNED

    changes: Mapping[str, Any] = field(default_factory=dict)
    """Of the preset's hyper-parameters."""

    goals: int = 200
    """Of each evaluation of a trained policy."""

    curve_every: int = 5_000
    """Updates between points of the learning curve."""

    curve_goals: int = 20
    """Of each point."""

    max_steps: int | None = None
    """Of evaluated episodes, where it is not the task's."""

    def __post_init__(self) -> None:
        """Refuse what could not be run.

        Raises:
            UsageError: Saying what could.
        """
        _check_name(self.name)
        preset(self.algorithm, self.preset)  # raises
        _check_choice("algorithm", self.algorithm, names(online=False))
        if self.goals < 2 or self.goals % 2:
            raise UsageError(f"goals is {self.goals}, expected 2, 4, 6 ...: each way")
        known = {one.name for one in fields(preset(self.algorithm))}
        for name in set(self.changes) - known:
            raise UsageError(
                f"setting {self.name!r} changes {name!r}, which {self.algorithm} has "
                f"not: expected some of {', '.join(sorted(known))}"
            )
        self._check_changes()

    def _check_changes(self) -> None:
        hints = get_type_hints(type(preset(self.algorithm)))
        for name, value in self.changes.items():
            try:
                check_type(value, hints[name])
            except TypeCheckError as error:
                raise UsageError(
                    f"setting {self.name!r} changes {name} to {value!r}: {error}"
                ) from None
        try:
            _ = self.config
        except UsageError as error:
            raise UsageError(f"setting {self.name!r}: {error}") from None

    @property
    def config(self) -> Any:
        """Its hyper-parameters."""
        return replace(preset(self.algorithm, self.preset), **self.changes)


Cell = tuple[str, Setting]
"""A line of a table or a curve of a figure: a dataset, and how to learn from it.

Datasets of the paper go by their names; any other id is its own name.
"""


def cell_name(cell: Cell) -> tuple[str, str]:
    """Names of dataset and setting."""
    return cell[0], cell[1].name


@dataclass(frozen=True)
class Probe:
    """An evaluation of a trained run."""

    name: str
    """In rows, and of its file in the run."""

    about: str
    """In tables."""

    checkpoint: Literal["last", "best"] = "last"

    overrides: Mapping[str, Any] = field(default_factory=dict)
    """Of the task."""

    alpha: float | None = None
    """Held at this, whatever the policy sets."""

    def __post_init__(self) -> None:
        """Refuse what could not be done.

        Raises:
            UsageError: Saying what could.
        """
        _check_name(self.name)
        _check_choice("checkpoint", self.checkpoint, ("last", "best"))
        if self.alpha is not None and not 0 <= self.alpha <= 1:
            raise UsageError(f"alpha is {self.alpha}, expected a number in [0, 1]")
        make_task(overrides=self.overrides)  # raises


LAST = Probe("last", "at the end")
BEST = Probe("best", "at the best checkpoint", checkpoint="best")


@dataclass(frozen=True)
class Reported:
    """What others report of a cell, to stand beside ours."""

    where: str
    """Table, figure or section."""

    success: float | None = None
    """Goals reached, mean over seeds [%]; None: only told in words."""

    deviation: float | None = None
    """Over seeds [%]."""

    words: str = ""

    def __str__(self) -> str:
        told = self.words
        if self.success is not None:
            spread = "" if self.deviation is None else f" +- {self.deviation:.2f}"
            told = f"{self.success:.2f}{spread}"
        return f"{told} ({self.where})"


@dataclass(frozen=True)
class Ablation:
    """A table, and maybe a figure of learning curves."""

    about: str
    cells: Sequence[Cell]

    probes: Sequence[Probe] = (LAST,)
    """How each run is evaluated."""

    figure: bool = False
    """Whether learning curves are drawn: a panel per preset, a line per cell."""

    reported: Mapping[tuple[str, str], Reported] = field(default_factory=dict)
    """By names of dataset and setting."""

    seeds: int = 3
    """Runs of each cell; they are seeded 0, 1, 2 ..."""

    def __post_init__(self) -> None:
        """Refuse what could not be told apart.

        Raises:
            UsageError: Naming what stands there twice, or is no cell.
        """
        if not self.cells:
            raise UsageError(f"{self.about!r} has no cells")
        for cell in self.cells:
            match cell:
                case (str(), Setting()):
                    pass
                case _:
                    raise UsageError(
                        f"{cell!r} is no cell, expected pairs of a dataset's name and "
                        "a Setting"
                    )
        if self.seeds < 1:
            raise UsageError(f"{self.about!r} has {self.seeds} seeds, expected >= 1")
        known = set(map(cell_name, self.cells))
        for name in self.reported:
            if name not in known:
                raise UsageError(f"{name!r} is reported, but no cell has these names")
        _check_once([f"{dataset}, {one.name}" for dataset, one in self.cells])
        _check_once([probe.name for probe in self.probes])
