"""Moments that Ctrl-C must not cut in two."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_deaf = 0
"""How many blocks that must not be interrupted are open."""


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C in the block, and in processes that are started there."""
    global _deaf
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    _deaf += 1
    try:
        yield
    finally:
        _deaf -= 1
        signal.signal(signal.SIGINT, previous)


def terminate_as_interrupt(number: int, frame: object) -> None:
    """A handler that ends a command on SIGTERM as Ctrl-C does: workers and files too.

    It does not go by way of SIGINT, which is ignored in jobs that a script started in
    the background.
    """
    if not _deaf:
        raise KeyboardInterrupt
