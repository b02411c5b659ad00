"""Loggers of a run beside its record ``metrics.jsonl``: TensorBoard, CSV, W&B."""

import csv
import io
import itertools
import json
import os
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from secrets import token_hex
from typing import Any, Protocol

from marl_mm.errors import UsageError
from marl_mm.files import append, new_file

CSV = "metrics.csv"
"""The rows of ``metrics.jsonl`` as a table."""

LOGGED = ("events.out.tfevents.*", CSV, "wandb")
"""Files of the loggers in a run's folder, which a fresh run deletes."""

PROJECT = "marl_mm"
"""Project of Weights & Biases, unless ``WANDB_PROJECT`` names another."""

_EVENT_FILES = itertools.count()
"""Numbers of the event files of this process, a part of their names."""

Row = dict[str, Any]
"""A line of a run's metrics."""


class Logger(Protocol):
    """Takes a run's rows, one after the other."""

    def log(self, step: int, row: Mapping[str, Any]) -> None:
        """Take a row.

        Args:
            step: Progress of the run, in updates or episodes.
            row: Metrics by name, with that number among them.
        """

    def close(self, failed: bool) -> None:
        """Finish, after an error or without one."""


class TensorBoardLogger:
    """TensorBoard's event files in the run's folder.

    TensorBoard's own writer does so in a thread, which fails alone on a full disk.

    Args:
        run: The run's folder.
        clock: Name of the progress in a row, which is no scalar.
        rows: Rows that the run has already.
    """

    def __init__(self, run: Path, clock: str, rows: Sequence[Row]) -> None:
        # It imports protobuf and more, which takes a second.
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog

        self._clock = clock
        name = f"{int(time.time()):010d}.{socket.gethostname()}.{os.getpid()}"
        self._path = run / f"events.out.tfevents.{name}.{next(_EVENT_FILES)}"
        first = [Event(file_version="brain.Event:2")]
        if rows and (since := rows[-1][clock]):
            # TensorBoard drops what other files have of this step and later ones.
            start = SessionLog(status=SessionLog.START)
            first.append(Event(step=since + 1, session_log=start))
        self._write(first)

    def log(self, step: int, row: Mapping[str, Any]) -> None:
        """Write a row's numbers as scalars."""
        from tensorboard.compat.proto.event_pb2 import Event
        from tensorboard.compat.proto.summary_pb2 import Summary

        values = [
            Summary.Value(tag=key, simple_value=float(value))
            for key, value in row.items()
            if key != self._clock
        ]
        self._write([Event(step=step, summary=Summary(value=[v])) for v in values])

    def _write(self, events: Sequence[Any]) -> None:
        from tensorboard.summary.writer.record_writer import RecordWriter

        records = io.BytesIO()
        writer = RecordWriter(records)
        for event in events:
            event.wall_time = time.time()
            writer.write(event.SerializeToString())
        append(self._path, records.getvalue())

    def close(self, failed: bool) -> None:
        """Nothing is open between rows."""


class CsvLogger:
    """``metrics.csv`` in the run's folder; a row that has more columns rewrites it.

    Args:
        run: The run's folder.
        clock: Name of the progress in a row, the first column.
        rows: Rows that the run has already.
    """

    def __init__(self, run: Path, clock: str, rows: Sequence[Row]) -> None:
        self._path, self._rows = run / CSV, [*rows]
        self._columns = list(dict.fromkeys([clock, *(key for r in rows for key in r)]))
        self._rewrite()

    def log(self, step: int, row: Mapping[str, Any]) -> None:
        """Append a row."""
        self._rows.append(dict(row))
        new = [key for key in row if key not in self._columns]
        if new:
            self._columns += new
            self._rewrite()
        else:
            line = io.StringIO(newline="")
            csv.DictWriter(line, self._columns).writerow(row)
            append(self._path, line.getvalue().encode())

    def close(self, failed: bool) -> None:
        """Nothing is open between rows."""

    def _rewrite(self) -> None:
        with new_file(self._path) as path, path.open("w", newline="") as file:
            writer = csv.DictWriter(file, self._columns)
            writer.writeheader()
            writer.writerows(self._rows)


class WandbLogger:
    """A run of Weights & Biases, which ``WANDB_*`` variables configure.

    It resumes the run whose local files are in the folder. Offline, each part of it is
    a folder of its own; ``wandb sync --append`` joins them.

    Args:
        run: The run's folder.
        clock: Name of the progress in a row, which is the step there.
        rows: Rows that the run has already.

    Raises:
        UsageError: If Weights & Biases does not start the run.
    """

    def __init__(self, run: Path, clock: str, rows: Sequence[Row]) -> None:
        import wandb

        settings = wandb.Settings(silent=True, console="off", disable_git=True)
        wandb.setup(settings=settings)
        before = [*run.glob("wandb/*/run-*.wandb")] if rows else []
        # Given none, it would take that of the process's last run.
        run_id = before[0].stem.removeprefix("run-") if before else token_hex(4)
        config = run / "config.json"
        self._clock = clock
        try:
            self._run = wandb.init(
                project=os.environ.get("WANDB_PROJECT", PROJECT),
                dir=run,
                group=run.parent.name or None,
                name=f"{run.parent.name}/{run.name}",
                id=run_id,
                resume="allow" if before else None,
                config=json.loads(config.read_bytes()) if config.exists() else None,
                reinit="create_new",  # several seeds of a process side by side
                settings=settings,
            )
        except wandb.Error as error:
            raise UsageError(f"Weights & Biases: {error}") from error

    def log(self, step: int, row: Mapping[str, Any]) -> None:
        """Send a row; a step that is there already keeps its first row."""
        values = {key: value for key, value in row.items() if key != self._clock}
        self._run.log(values, step=step)

    def close(self, failed: bool) -> None:
        """Finish the run, and wait until its rows are sent."""
        self._run.finish(exit_code=int(failed))


LOGGERS: Mapping[str, Callable[[Path, str, Sequence[Row]], Logger]] = {
    "tensorboard": TensorBoardLogger,
    "csv": CsvLogger,
    "wandb": WandbLogger,
}
"""Loggers by name, made of a run's folder, the name of its progress and its rows."""

DEFAULT_LOGGERS = ("tensorboard",)


def check_loggers(names: Sequence[str]) -> None:
    """Raise before any work is done if a logger cannot start.

    Raises:
        UsageError: If there is no such logger, one is named twice, or Weights & Biases
            is not installed or knows no account.
    """
    if len({*names}) < len(names):
        raise UsageError(f"`logger` is {' '.join(names)}, expected each once")
    for name in names:
        if name not in LOGGERS:
            raise UsageError(
                f"there is no logger {name!r}, expected one of {', '.join(LOGGERS)}"
            )
    if "wandb" not in names:
        return
    if find_spec("wandb") is None:
        raise UsageError("wandb is missing: pip install -e '.[wandb]'")
    import wandb

    online = os.environ.get("WANDB_MODE", "online") == "online"
    if online and wandb.api.api_key is None:
        raise UsageError(
            "Weights & Biases knows no account: run `wandb login`, or set "
            "WANDB_MODE=offline"
        )
