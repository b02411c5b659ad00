"""Progress with ETA on stderr, so that stdout holds nothing but results."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

Advance = Callable[[int, str], None]
"""Called with the work done since the last call and a short note."""


_LINE = 60.0
"""Seconds between lines where there is no terminal to redraw."""


@contextmanager
def progress_bar(label: str, total: int) -> Iterator[Advance]:
    """A bar for ``total`` units of work; into a pipe or a file, a line per minute."""
    bar = Progress(
        TextColumn(f"{label:<16}"),
        BarColumn(bar_width=6),  # all of it and a note fit into 80 columns
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=Console(stderr=True),
        speed_estimate_period=600,  # an evaluation between may take a minute
    )
    with bar:
        task = bar.add_task(label, total=total, note="")
        shown = time.monotonic()

        def advance(done: int, note: str) -> None:
            nonlocal shown
            bar.update(task, advance=done)
            if note:
                bar.update(task, note=note)
            if not bar.console.is_terminal and time.monotonic() - shown > _LINE:
                shown = time.monotonic()
                bar.console.print(bar.get_renderable())

        yield advance


def silent(done: int, note: str) -> None:
    """Progress for callers who do not want any."""
