"""Processes that begin as copies of one that has imported what they need.

They begin in milliseconds instead of seconds, and share the libraries' memory.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver, get_context
from multiprocessing.context import ForkServerContext
from pathlib import Path

from marl_mm.interrupts import deaf_to_interrupts

_FREEZE = "marl_mm.frozen"
"""Imported last."""


def process_context(module: str) -> ForkServerContext:
    """A context of ``multiprocessing`` that makes them.

    Args:
        module: That the one which is copied imports, if this is the first call; it
            ends with this process.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([module, _FREEZE])
    with deaf_to_interrupts(), _of_this_package():
        forkserver.ensure_running()
    return context


@contextmanager
def _of_this_package() -> Iterator[None]:
    """A server started here imports this package, not one that lies where we are."""
    package = str(Path(__file__).resolve().parents[1])
    known = os.environ.get("PYTHONPATH")
    changes = {
        "PYTHONSAFEPATH": "1",
        "PYTHONPATH": os.pathsep.join(filter(None, (package, known))),
    }
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
