"""What a run writes as it trains: ``metrics.jsonl`` and TensorBoard's event files."""

import json
from pathlib import Path
from typing import Any

from marl_mm.files import new_file

METRICS = "metrics.jsonl"

Row = dict[str, Any]


class RunLog:
    """Appends rows to a run's metrics; use it in a ``with`` block.

    Args:
        run: The run's folder.
        clock: Key of a row that counts its progress, ``step`` or ``episode``.
        since: Where the run stands: rows beyond are of an attempt that was cut off
            after its last checkpoint, and go.
    """

    def __init__(self, run: Path, clock: str, since: int) -> None:
        # It imports protobuf and more, which takes a second.
        from torch.utils.tensorboard import SummaryWriter

        self._path, self._clock = run / METRICS, clock
        self.rows = [row for row in read_metrics(run) if row[clock] <= since]
        """All rows of the run so far."""

        with new_file(self._path) as temporary:
            temporary.write_text("".join(map(_line, self.rows)))
        self._writer = SummaryWriter(str(run), purge_step=since + 1 if since else None)

    def __enter__(self) -> "RunLog":
        return self

    def __exit__(self, *exception: object) -> None:
        self._writer.close()

    def add(self, row: Row) -> None:
        """Write a row; its numbers are TensorBoard's scalars, too."""
        self.rows.append(row)
        with self._path.open("a") as file:
            file.write(_line(row))
        for key, value in row.items():
            if key != self._clock:
                self._writer.add_scalar(key, value, row[self._clock])
        self._writer.flush()


def read_metrics(run: Path) -> list[Row]:
    """The rows of a run's ``metrics.jsonl``; a last line cut off is left out."""
    path = run / METRICS
    if not path.exists():
        return []
    lines = path.read_text().splitlines(keepends=True)
    return [json.loads(line) for line in lines if line.endswith("\n")]


def _line(row: Row) -> str:
    return json.dumps(row) + "\n"
