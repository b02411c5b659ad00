"""Declarations of what a study shows: results of others, and learning curves."""

from dataclasses import dataclass
from typing import Literal, get_args

from marl_mm.errors import UsageError

Panels = Literal["preset", "task", "dataset"]

_SUCCESS = ("success/all", "success/forward", "success/backward", "return/all")
COLUMNS = {
    "step": (*_SUCCESS, "q/policy", "q/slope"),
    "episode": (
        *("env_steps", "updates", *_SUCCESS, "alpha/forward", "alpha/backward"),
        *("train/return", "train/success", "q/data", "q/policy", "action/saturation"),
    ),
}
"""Columns of learning curves, by the clock of the run: updates or episodes.

They are nan where a run has none, such as of goals behind.
"""


@dataclass(frozen=True)
class Reported:
    """A reported result of a cell, shown beside ours."""

    where: str
    """Source: a table, figure or section."""

    success: float | None = None
    """Goals reached, mean over seeds [%]; None where ``words`` has the result."""

    deviation: float | None = None
    """Standard deviation over seeds [%]."""

    words: str = ""
    """The result in words."""

    updates: int | None = None
    """Updates of the reported runs: only runs of as many are compared with them; None:
    all are."""

    def __str__(self) -> str:
        text = self.words
        if self.success is not None:
            spread = "" if self.deviation is None else f" +- {self.deviation:.2f}"
            text = f"{self.success:.2f}{spread}"
        return f"{text} ({self.where})"


@dataclass(frozen=True)
class Curves:
    """A figure of learning curves: mean and deviation over seeds, a line per cell."""

    value: str = "success_all"
    """Column of the learning curves that is drawn."""

    label: str = "goals reached [%]"
    """Name of the axis, with its unit."""

    scale: float = 100.0
    """Factor of the values."""

    bottom: float | None = -3.0
    """Lower end of the axis; None shows everything."""

    top: float | None = 103.0
    """Upper end of the axis; None shows everything."""

    panels: Panels = "preset"
    """Grouping of cells into panels."""

    def __post_init__(self) -> None:
        if self.panels not in get_args(Panels):
            choices = " or ".join(get_args(Panels))
            raise UsageError(f"panels is {self.panels!r:.40}, expected {choices}")
