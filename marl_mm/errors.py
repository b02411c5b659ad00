"""Everything marl_mm raises on purpose.

A message says what was wrong, what was got, what was expected, and what to do. The
command line prints it as one line and exits with the class's ``exit_code``.
"""


class MarlMmError(Exception):
    """Base of all errors; by itself, something failed that was asked for correctly."""

    exit_code = 1


class UsageError(MarlMmError, ValueError):
    """What the caller asked for makes no sense: a bad value, name or path."""

    exit_code = 2


class OutputExistsError(UsageError):
    """The output exists already and may not be overwritten."""


class OtherConfigError(UsageError):
    """A run was made with other options than those that are to go on with it.

    Args:
        difference: What was made with what.
        advice: What to do.
    """

    def __init__(self, difference: str, advice: str) -> None:
        super().__init__(difference, advice)
        self.difference, self.advice = difference, advice

    def __str__(self) -> str:
        return f"{self.difference}: {self.advice}"


class LayoutError(UsageError):
    """A layout makes no sense, or is another one than what it meets."""


class PluginError(MarlMmError):
    """The code of a plug-in fails."""


class UnknownDatasetError(UsageError):
    """No dataset has this id or path."""


class DatasetError(MarlMmError):
    """A dataset's files are damaged or not in the expected layout."""


class CheckpointError(MarlMmError):
    """A checkpoint is damaged or belongs to something else."""


class ExportError(MarlMmError):
    """An exported policy does not act as the run's."""


class FailedRunsError(MarlMmError):
    """Some runs of many failed, the others did not."""


class WorkerDiedError(MarlMmError):
    """A process that did part of the work is gone."""


class HopelessError(MarlMmError):
    """A collector hardly ever produces an episode that a dataset would keep."""


class DivergedError(MarlMmError):
    """Training produced a NaN, an infinity, or a value beyond all returns."""


class InvalidActionError(MarlMmError, ValueError):
    """An action of the wrong shape, or with a NaN or an infinity in it."""


class NonFiniteStateError(MarlMmError):
    """The simulation or the controller produced a NaN or an infinity."""
