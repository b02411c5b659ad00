"""What a run writes as it trains: ``metrics.jsonl`` and TensorBoard's event files."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypedDict

from marl_mm.errors import CheckpointError
from marl_mm.files import new_file

METRICS = "metrics.jsonl"

Row = dict[str, Any]
"""A line of a run's metrics."""

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
"""What a learning curve keeps of an evaluation, by direction; nothing of what was not
measured."""


class RunLog:
    """Appends rows to a run's metrics; use it in a ``with`` block.

    Args:
        run: The run's folder.
        clock: Key of a row that counts its progress, ``step`` or ``episode``.
        since: Where the run stands: rows beyond are of an attempt that was cut off
            after its last checkpoint, and go.

    Raises:
        CheckpointError: If rows are damaged, or end before the checkpoint.
    """

    def __init__(self, run: Path, clock: str, since: int) -> None:
        self.run, self._clock, self._since = run, clock, since
        self._writer: Any = None
        self.rows = [row for row in read_metrics(run) if row[clock] <= since]
        """All rows of the run so far."""

        if since and (not self.rows or self.rows[-1][clock] != since):
            last = self.rows[-1][clock] if self.rows else "nowhere"
            raise CheckpointError(
                f"{run / METRICS} ends at {clock} {last}, the checkpoint beside it at "
                f"{since}: one was cut off; start anew with --overwrite"
            )
        with new_file(run / METRICS) as temporary:
            temporary.write_text("".join(map(_line, self.rows)))

    def __enter__(self) -> "RunLog":
        return self

    def __exit__(self, *exception: object) -> None:
        if self._writer is not None:
            self._writer.close()

    def add(self, row: Row) -> None:
        """Write a row; its numbers are TensorBoard's scalars, too."""
        if self._writer is None:
            # It imports protobuf and more, which takes a second.
            from torch.utils.tensorboard import SummaryWriter

            purge = self._since + 1 if self._since else None
            self._writer = SummaryWriter(str(self.run), purge_step=purge)
        self.rows.append(row)
        with (self.run / METRICS).open("a") as file:
            file.write(_line(row))
        for key, value in row.items():
            if key != self._clock:
                self._writer.add_scalar(key, value, row[self._clock])
        self._writer.flush()


def read_metrics(run: Path) -> list[Row]:
    """The rows of a run's ``metrics.jsonl``; a last line cut off is left out.

    Raises:
        CheckpointError: If another line is damaged.
    """
    path = run / METRICS
    if not path.exists():
        return []
    lines = path.read_text().splitlines(keepends=True)
    try:
        return [json.loads(line) for line in lines if line.endswith("\n")]
    except ValueError as error:
        raise CheckpointError(f"{path} is damaged ({error})") from error


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
