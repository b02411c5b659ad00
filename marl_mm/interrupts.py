"""Moments that Ctrl-C must not cut in two."""

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

_deaf = 0
"""How many blocks that must not be interrupted are open."""

_late = False
"""Whether an interrupt came while one was."""

_heard = float("-inf")
"""When the last interrupt came [s]."""

_ECHO = 1.0
"""An interrupt this soon after another is the same one [s]: ``timeout`` and some shells
send it to the process and to its group."""


@contextmanager
def deaf_to_interrupts(*, forget: bool = False) -> Iterator[None]:
    """Hold back Ctrl-C until the block is over; processes started there never hear it.

    Args:
        forget: Whether an interrupt is dropped: there was one already.

    Raises:
        KeyboardInterrupt: After the block, if there was one in it and no other
            exception is on its way.
    """
    global _deaf, _late
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _deaf += 1  # first of all: from here on, ``interrupt`` only postpones
    handler = signal.getsignal(signal.SIGINT)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ())  # as it is
    try:
        if handler is not signal.SIG_IGN:  # as it is in jobs in the background
            signal.signal(signal.SIGINT, _postpone)
        # The mask is for processes started here: they inherit it, no handler.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
        _deaf -= 1
        if not _deaf:
            late, _late = _late and not forget, False
            if late and sys.exc_info()[0] is None:
                raise KeyboardInterrupt


def end_on_signals() -> None:
    """Let SIGINT and SIGTERM alike end a command: its workers and files, too.

    SIGTERM does not go by way of SIGINT, which is ignored in jobs that a script started
    in the background, and stays so.
    """
    signal.signal(signal.SIGTERM, interrupt)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, interrupt)


def interrupt(number: int, frame: object) -> None:
    """A handler of signals; one that repeats the last does nothing.

    Raises:
        KeyboardInterrupt: Unless a block holds it back.
    """
    if _deaf:
        _postpone(number, frame)
    elif not _is_echo():
        raise KeyboardInterrupt


def _postpone(number: int, frame: object) -> None:
    global _late
    if not _is_echo():
        _late = True


def _is_echo() -> bool:
    """Note that an interrupt has come; whether it repeats the last."""
    global _heard
    now = time.monotonic()
    if now - _heard < _ECHO:
        return True
    _heard = now
    return False
