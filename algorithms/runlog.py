"""The log of a run: its record, ``metrics.jsonl``, and the loggers beside it."""

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
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
from marl_mm.received import (
    check_kind,
    check_regular,
    is_printable,
    parse_json,
    refuse_links_out,
)

METRICS = "metrics.jsonl"
"""The record of a run: JSON lines, one a row."""

METRICS_BYTES = 100_000_000
"""Largest size of the record [bytes]; a row has less than 2,000."""

_LINE_BYTES = 100_000
"""Largest size of a row [bytes]."""

MOST_ROWS = 100_000
"""Largest number of rows in the record."""

_VALUES, _NAMES = 5_000_000, 1_000
"""Largest numbers of values and of their names in the record."""

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
        self.rows = [row for row in read_metrics(run, clock) if row[clock] <= since]
        """All rows of the run so far."""

        if since and (not self.rows or self.rows[-1][clock] != since):
            last = self.rows[-1][clock] if self.rows else "nowhere"
            raise CheckpointError(
                f"{run / METRICS} ends at {clock} {last}, the checkpoint beside it at "
                f"{since}: one was cut off; start anew with `overwrite=True`"
            )
        with new_file(run / METRICS) as temporary:
            temporary.write_text("".join(map(_line, self.rows)), "utf-8")

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


def read_metrics(run: Path, clock: str | None = None) -> list[Row]:
    """The rows of a run's ``metrics.jsonl``; a last line cut off is left out.

    Args:
        run: The run's folder.
        clock: Key that every row has to have; None: any.

    Raises:
        CheckpointError: If another line is damaged, or there are far too many; if the
            file is a link out of the run's folder.
    """
    path = run / METRICS
    refuse_links_out(run, [METRICS], CheckpointError)
    if not path.exists():
        return []
    check_regular(path, CheckpointError, METRICS_BYTES)
    rows: list[Row] = []
    names: set[str] = set()
    values = 0
    for line in _lines(path):
        row = _parsed(line, str(path))
        rows.append({sys.intern(name): value for name, value in row.items()})
        values += len(row)
        names |= row.keys()
        empty = not row or (clock is not None and clock not in row)
        if empty or len(rows) > MOST_ROWS or values > _VALUES or len(names) > _NAMES:
            raise CheckpointError(
                f"{path} is damaged: it has a row without {clock or 'values'}, or more "
                f"than {MOST_ROWS:,} rows, {_VALUES:,} values or {_NAMES:,} names of "
                "them"
            )
    return rows


def _parsed(line: str, where: str) -> Row:
    with suppress(ValueError, RecursionError):
        row = json.loads(line)
        numbers = isinstance(row, dict) and {*map(type, row.values())} <= {int, float}
        if numbers and is_printable("".join(row)):  # the usual case, in less time
            return dict(row)
    row = parse_json(line, where, CheckpointError)
    check_kind(row, dict[str, float], where, CheckpointError)
    return dict(row)


def _lines(path: Path) -> Iterator[str]:
    """Lines of a file that are whole."""
    try:
        with path.open("rb") as file:
            while (line := file.readline(_LINE_BYTES)).endswith(b"\n"):
                yield line.decode()
            if len(line) == _LINE_BYTES:
                raise ValueError(f"a line of more than {_LINE_BYTES:,} bytes")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise CheckpointError(f"cannot read {path}: {reason}") from error


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
