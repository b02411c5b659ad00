"""Progress with ETA on stderr, so that stdout holds nothing but results."""

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column
from rich.text import Text

Advance = Callable[[int, str], None]
"""Function that is called with the work done since the last call and a short note."""

Bar = Callable[[str, int], Advance]
"""Function of a label and an amount of work that begins a bar."""

_LINE = 60.0
"""Time between lines where there is no terminal to redraw [s]."""

_WIDTH = 120
"""Usual width of those lines, in which whole labels fit."""

_LOST = 5.0
"""Longest wait for last messages [s]: a process that was killed may hold the queue."""


class _Elastic(TextColumn):
    """Column of text that is cut off in narrow terminals, so that numbers are not."""

    def __init__(self, form: str) -> None:
        super().__init__(form, markup=False, table_column=Column(no_wrap=False))

    def render(self, task: Task) -> Text:
        """The text in one line."""
        text = super().render(task)
        text.no_wrap, text.overflow = True, "ellipsis"
        return text


class _Bars(Progress):
    """Bars of which nothing is left if there is an error before any work."""

    def __exit__(self, *exception: Any) -> None:
        if exception[0] is None or any(task.completed for task in self.tasks):
            self.stop()
        else:
            self.live.transient = True
            self.live.stop()  # without the line that a file gets after bars


@contextmanager
def progress_bars(vanish: bool = False) -> Iterator[Bar]:
    """Bars below one another; a pipe or a file gets one line per bar and minute.

    Args:
        vanish: Whether full bars disappear.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        console.width = shutil.get_terminal_size((_WIDTH, 24)).columns  # or COLUMNS
    bars = _Bars(
        _Elastic("{task.description:<16}"),
        BarColumn(bar_width=6),  # all of it and a note fit into 80 columns
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        _Elastic("{task.fields[note]}"),
        console=console,
        redirect_stdout=sys.stdout.isatty(),  # results may go to a file
        speed_estimate_period=600,  # an evaluation between may take a minute
    )
    begun = ExitStack()
    shown = time.monotonic()

    def bar(label: str, total: int) -> Advance:
        if not bars.live.is_started:
            begun.enter_context(bars)
        task = bars.add_task(label, total=total, note="")
        done_so_far = 0

        def advance(done: int, note: str) -> None:
            nonlocal shown, done_so_far
            bars.update(task, advance=done)
            done_so_far += done
            if note:
                bars.update(task, note=note)
            if vanish and done_so_far >= total:
                bars.update(task, visible=False)
            if not bars.console.is_terminal and time.monotonic() - shown > _LINE:
                shown = time.monotonic()
                bars.console.print(bars.get_renderable())

        return advance

    with begun:
        yield bar


@contextmanager
def progress_bar(label: str, total: int) -> Iterator[Advance]:
    """A single bar for ``total`` units of work."""
    with progress_bars() as bar:
        yield bar(label, total)


def silent(done: int, note: str) -> None:
    """Ignore progress."""


def silent_bar(label: str, total: int) -> Advance:
    """A bar that shows nothing."""
    return silent


def distant_bars(messages: "Queue[Any]", stop: Event) -> Bar:
    """Bars of this process that another process shows, which reads ``messages``.

    Args:
        messages: Queue that ``show_distant_bars`` reads.
        stop: Event that the other process sets to end the work: the next step of a bar
            raises KeyboardInterrupt.
    """

    def bar(label: str, total: int) -> Advance:
        messages.put((label, total, 0, ""))

        def advance(done: int, note: str) -> None:
            messages.put((label, total, done, note))
            if stop.is_set():
                raise KeyboardInterrupt

        return advance

    return bar


@contextmanager
def show_distant_bars(messages: "Queue[Any]", stop: Event, bar: Bar) -> Iterator[None]:
    """Show the bars of other processes until the block ends; their labels must differ.

    Args:
        messages: Queue that ``distant_bars`` writes to.
        stop: Event that ends the work of the other processes.
        bar: Begins a bar of this process; it is called in a thread. An error that it
            raises ends the work, and is raised here at the end of the block.
    """
    failures: list[BaseException] = []

    def show() -> None:
        bars: dict[str, Advance] = {}
        seen = True
        while (message := messages.get()) is not None:
            label, total, done, note = message
            try:
                if seen and label not in bars:
                    bars[label] = bar(label, total)
                if seen:
                    bars[label](done, note)
            except OSError:  # nobody reads stderr any more
                seen = False
            except BaseException as error:
                failures.append(error)
                seen = False
                stop.set()

    thread = threading.Thread(target=show, daemon=True)
    thread.start()
    try:
        yield
    finally:
        messages.put(None)
        thread.join(_LOST)
        messages.cancel_join_thread()
        messages.close()
        if failures:
            raise failures[0]
