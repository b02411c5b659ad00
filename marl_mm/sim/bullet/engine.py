"""PyBullet, imported in silence; the other modules here take it from this one."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def _silenced_stderr() -> Iterator[None]:
    """PyBullet greets on stderr when imported; ours is for progress and errors."""
    saved = -1
    if sys.stderr is not None:  # closed, as a daemon's: file 2 may be anything
        with suppress(OSError):  # closed, and another stream in its place
            saved = os.dup(2)
    if saved < 0:
        yield
        return
    sys.stderr.flush()
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(null)


with _silenced_stderr():
    import pybullet
    import pybullet_data

__all__ = ["pybullet", "pybullet_data"]
