"""Blocks that Ctrl-C must not interrupt."""

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

_deaf = 0
"""Number of open blocks that must not be interrupted."""

_late = False
"""Whether an interrupt came during an open block."""

_heard = float("-inf")
"""Time of the last interrupt [s]."""

_ECHO = 1.0
"""Time within which a second interrupt counts as the first [s]: ``timeout`` and some
shells send it to the process and to its group."""


@contextmanager
def deaf_to_interrupts(*, forget: bool = False) -> Iterator[None]:
    """Hold back Ctrl-C until the block ends; processes started in it never get it.

    Args:
        forget: Whether an interrupt is dropped, as there was one already.

    Raises:
        KeyboardInterrupt: After the block, if an interrupt came in it, the block raises
            nothing else, and no other interrupt is being handled.
    """
    global _deaf, _late
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handled = sys.exc_info()[1]
    _deaf += 1  # before all else: from here on, ``interrupt`` only postpones
    handler = signal.getsignal(signal.SIGINT)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ())  # unchanged
    try:
        if handler is not signal.SIG_IGN:  # ignored in jobs in the background
            signal.signal(signal.SIGINT, _postpone)
        # Processes started here inherit the mask, but no handler.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
        _deaf -= 1
        if not _deaf:
            late, _late = _late and not forget, False
            now = sys.exc_info()[1]
            if late and now is handled and not isinstance(now, KeyboardInterrupt):
                raise KeyboardInterrupt


def end_on_signals() -> None:
    """Let SIGINT and SIGTERM end a command alike, with its workers and open files.

    SIGTERM has a handler of its own: SIGINT stays ignored in jobs that a script started
    in the background.
    """
    signal.signal(signal.SIGTERM, interrupt)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, interrupt)


def interrupt(number: int, frame: object) -> None:
    """Handler of SIGINT and SIGTERM, which ignores an echo of the last signal.

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
    """Note the time of an interrupt; return whether it repeats the last one."""
    global _heard
    now = time.monotonic()
    if now - _heard < _ECHO:
        return True
    _heard = now
    return False
