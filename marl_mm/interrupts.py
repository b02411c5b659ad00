"""Moments that Ctrl-C must not cut in two."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_deaf = 0
"""How many blocks that must not be interrupted are open."""

_late = False
"""Whether an interrupt came while one was."""


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
    handler = signal.getsignal(signal.SIGINT)
    if handler is not signal.SIG_IGN:  # as it is in jobs in the background
        signal.signal(signal.SIGINT, _postpone)
    # The mask is for processes started here: they inherit it, a handler they do not.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    _deaf += 1
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
        _deaf -= 1
        if not _deaf:
            late, _late = _late and not forget, False
            if late and sys.exc_info()[0] is None:
                raise KeyboardInterrupt


def terminate_as_interrupt(number: int, frame: object) -> None:
    """A handler that ends a command on SIGTERM as Ctrl-C does: workers and files too.

    It does not go by way of SIGINT, which is ignored in jobs that a script started in
    the background.
    """
    if _deaf:
        _postpone(number, frame)
    else:
        raise KeyboardInterrupt


def _postpone(number: int, frame: object) -> None:
    global _late
    _late = True
