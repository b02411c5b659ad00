"""The log of a run: its record, ``metrics.jsonl``, and the loggers beside it."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypedDict

from marl_mm.algorithms.loggers import (
    DEFAULT_LOGGERS,
    LOGGERS,
    Logger,
    Row,
    check_loggers,
)
from marl_mm.errors import CheckpointError
from marl_mm.files import append, new_file
from marl_mm.received import check_kind, parse_json, read_text

METRICS = "metrics.jsonl"
"""The record of a run: JSON lines, one a row."""

METRICS_BYTES = 1_000_000_000
"""Largest size of the record [bytes]."""

CurvePoint = TypedDict(
    "CurvePoint",
    {
        "success/all": float,
        "return/all": float,
        "alpha/all": float,
        "success/forward": float,
        "return/forward": float,
        "alpha/forward": float,
        "success/backward": float,
        "return/backward": float,
        "alpha/backward": float,
    },
    total=False,
)
"""Point of a learning curve: an evaluation by direction, without what it lacks."""


class RunLog:
    """Appends rows to a run's record and to its loggers; use it in a ``with`` block.

    Args:
        run: The run's folder.
        clock: Key of a row that counts its progress, ``step`` or ``episode``.
        since: Progress of the run's checkpoint. Rows beyond it are of an attempt that
            was cut off, and are deleted.
        loggers: Names of the loggers beside the record, see ``LOGGERS``. They start
            with the first row.

    Raises:
        CheckpointError: If rows are damaged, or end before the checkpoint.
        UsageError: If a logger is unknown or cannot start.
    """

    def __init__(
        self,
        run: Path,
        clock: str,
        since: int,
        loggers: Sequence[str] = DEFAULT_LOGGERS,
    ) -> None:
        check_loggers(loggers)
        self.run, self._clock, self._names = run, clock, loggers
        self._loggers: list[Logger] | None = None
        self.rows = [row for row in read_metrics(run) if row[clock] <= since]
        """All rows of the run so far."""

        if since and (not self.rows or self.rows[-1][clock] != since):
            last = self.rows[-1][clock] if self.rows else "nowhere"
            raise CheckpointError(
                f"{run / METRICS} ends at {clock} {last}, the checkpoint beside it at "
                f"{since}: one was cut off; start anew with `overwrite=True`"
            )
        with new_file(run / METRICS) as temporary:
            temporary.write_text("".join(map(_line, self.rows)))

    def __enter__(self) -> "RunLog":
        return self

    def __exit__(self, *exception: object) -> None:
        for logger in self._loggers or ():
            logger.close(failed=exception[0] is not None)

    def add(self, row: Row) -> None:
        """Write a row, and give it to every logger.

        Raises:
            OSError: If there is no room; it names the file, which stays as it was.
        """
        if self._loggers is None:
            self._loggers = [
                LOGGERS[name](self.run, self._clock, self.rows) for name in self._names
            ]
        self.rows.append(row)
        append(self.run / METRICS, _line(row).encode())
        for logger in self._loggers:
            logger.log(row[self._clock], row)


def read_metrics(run: Path) -> list[Row]:
    """The rows of a run's ``metrics.jsonl``; a last line cut off is left out.

    Raises:
        CheckpointError: If another line is damaged.
    """
    path = run / METRICS
    if not path.exists():
        return []
    lines = read_text(path, CheckpointError, METRICS_BYTES).splitlines(keepends=True)
    whole = [line for line in lines if line.endswith("\n")]
    rows = [parse_json(line, str(path), CheckpointError) for line in whole]
    check_kind(rows, list[dict[str, float]], str(path), CheckpointError)
    return rows


def merit(row: Row) -> tuple[float, ...]:
    """Success first, then return; less than anything where nothing was measured."""
    if "success/all" not in row:
        return (-1.0,)
    return row["success/all"], row["return/all"]


def is_best(row: Row, earlier: Iterable[Row]) -> bool:
    """Whether a row's evaluation is better than all before, of equals the first."""
    return merit(row) > max(map(merit, earlier), default=(-1.0,))


def _line(row: Row) -> str:
    return json.dumps(row) + "\n"
