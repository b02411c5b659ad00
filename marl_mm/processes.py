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

BEFORE = "MARL_MM_ENVIRONMENT"
"""Variable with all others, while the server begins: it begins with some changed."""

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
    known = os.environ.get("PYTHONPATH")
    before = dict(os.environ)
    os.environ["PYTHONSAFEPATH"] = "1"
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (package, known)))
    os.environ[BEFORE] = json.dumps(before)
    try:
        yield
    finally:
        set_environment(before)


def set_environment(variables: Mapping[str, str]) -> None:
    """These, and no others."""
    os.environ.clear()
    os.environ.update(variables)
