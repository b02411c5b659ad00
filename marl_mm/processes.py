"""Processes that begin as copies of one that has imported what they need.

They begin in milliseconds instead of seconds, and share the libraries' memory.
"""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import forkserver, get_context, resource_tracker
from multiprocessing.context import ForkServerContext
from pathlib import Path

from marl_mm.interrupts import deaf_to_interrupts

_CHANGED = ("PYTHONSAFEPATH", "PYTHONPATH")
"""Variables that are others while the server begins."""

BEFORE = "MARL_MM_VARIABLES"
"""One that tells it what they were."""

_LAST = "marl_mm.copied"


def process_context(module: str) -> ForkServerContext:
    """A context of ``multiprocessing`` that makes them.

    Args:
        module: That the one which is copied imports, if this is the first call; it
            ends with this process.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([module, _LAST])
    resource_tracker.ensure_running()  # which would let interrupts in, if begun below
    with deaf_to_interrupts(), _of_this_package():
        forkserver.ensure_running()
    return context


@contextmanager
def _of_this_package() -> Iterator[None]:
    """A server started here imports this package, not one that lies where we are."""
    package = str(Path(__file__).resolve().parents[1])
    before = {name: os.environ.get(name) for name in (*_CHANGED, BEFORE)}
    path = filter(None, (package, os.environ.get("PYTHONPATH")))
    changed = dict(zip(_CHANGED, ("1", os.pathsep.join(path)), strict=True))
    set_variables({**changed, BEFORE: json.dumps(before)})
    try:
        yield
    finally:
        set_variables(before)


def set_variables(values: Mapping[str, str | None]) -> None:
    """Set some of the environment, and remove those that are None."""
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
