"""Errors that marl_mm raises on purpose.

A message says what is wrong, what was got, what was expected, and what to do. It names
parameters in backquotes, as Python has them. The command line prints it as one line,
with options for parameters, and exits with the class's ``exit_code``.
"""

from collections.abc import Iterable
from difflib import SequenceMatcher
from pathlib import Path


def meant(name: str, names: Iterable[str], at_least: float = 0.6) -> str:
    """Words for a message about an unknown name: the names that are nearest to it.

    Args:
        name: The unknown name; of one with slashes the last part counts.
        names: Names that are known, alike.
        at_least: Smallest similarity of a name that is hinted, from 0 to 1.

    Returns:
        `` (did you mean A or B?)``, or nothing where no name is near.
    """
    likeness = SequenceMatcher(b=Path(name).name)
    ratios = {}
    for other in names:
        likeness.set_seq1(Path(other).name)
        ratios[other] = likeness.ratio()
    best = max(ratios.values(), default=0.0)
    if best < at_least:
        return ""
    near = [other for other, ratio in ratios.items() if ratio > best - 0.05]
    words = " or ".join([", ".join(near[:-1]), near[-1]]) if near[1:] else near[0]
    return f" (did you mean {words}?)"


class MarlMmError(Exception):
    """Base of all errors; by itself, a failure of something asked for correctly."""

    exit_code = 1


class UsageError(MarlMmError, ValueError):
    """A value, name or path that makes no sense."""

    exit_code = 2


class OutputExistsError(UsageError):
    """The output exists already and may not be overwritten."""


class OtherConfigError(UsageError):
    """A run that was begun with other options than those that continue it.

    Args:
        difference: The values that differ, in words.
        advice: The way out, in words.
    """

    def __init__(self, difference: str, advice: str) -> None:
        super().__init__(difference, advice)
        self.difference, self.advice = difference, advice

    def __str__(self) -> str:
        return f"{self.difference}: {self.advice}"


class LayoutError(UsageError):
    """A layout that makes no sense, or differs from the one that it meets."""


class PluginError(MarlMmError):
    """A failure in the code of a plug-in."""


class UnknownDatasetError(UsageError):
    """An id or path that no dataset has."""


class DatasetError(MarlMmError):
    """Files of a dataset that are damaged, or not in the expected layout."""


class CheckpointError(MarlMmError):
    """A checkpoint that is damaged, or belongs to something else."""


class SubmissionError(MarlMmError):
    """A submission that is damaged, or whose numbers are not those of its weights."""


class ExportError(MarlMmError):
    """An exported policy that does not act as the run's."""


class FailedRunsError(MarlMmError):
    """A failure of some runs among many."""


class WorkerDiedError(MarlMmError):
    """The end of a worker process before its work was done."""


class HopelessError(MarlMmError):
    """A collector that hardly ever produces an episode to keep."""


class DivergedError(MarlMmError):
    """Training that produced a NaN, an infinity, or a value beyond all returns."""


class InvalidActionError(MarlMmError, ValueError):
    """An action of the wrong shape, or with a NaN or an infinity in it."""


class NonFiniteStateError(MarlMmError):
    """A NaN or an infinity from the simulation or the controller."""
