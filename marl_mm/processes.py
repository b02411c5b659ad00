"""Worker processes that are forked from a server with the imports done.

They start in milliseconds instead of seconds, and share the libraries' memory.
"""

import ast
import json
import os
import pickle
import resource
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from multiprocessing import forkserver, get_context, resource_tracker
from multiprocessing.context import ForkServerContext
from pathlib import Path

from marl_mm.errors import UsageError
from marl_mm.interrupts import deaf_to_interrupts

_CHANGED = ("PYTHONSAFEPATH", "PYTHONPATH")
"""Environment variables that are changed while the server starts."""

SAVED = "MARL_MM_VARIABLES"
"""Environment variable that tells the server their former values, as JSON."""

_PRELOAD = "marl_mm.preload"


def process_context(module: str) -> ForkServerContext:
    """A ``multiprocessing`` context whose processes are forked from the server.

    Args:
        module: Module that the fork server preloads; only the first call counts. The
            server ends with this process.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([module, _PRELOAD])
    resource_tracker.ensure_running()  # which would let interrupts in, if begun below
    with deaf_to_interrupts(), _of_this_package():
        forkserver.ensure_running()
    return context


@contextmanager
def starting() -> Iterator[None]:
    """Start processes, which import the running script only if it has a guard.

    Without ``if __name__ == "__main__":`` each would do the script's work once more.
    """
    main = vars(sys.modules["__main__"])
    with _one_starts:  # or another thread would keep what is hidden as it is
        if "__file__" not in main or _is_imported():
            yield
            return
        hidden = {name: main.get(name) for name in ("__file__", "__spec__")}
        main.update(dict.fromkeys(hidden))
        try:
            yield
        finally:
            main.update(hidden)


_one_starts = threading.RLock()
"""Lock of what ``starting`` hides."""


def check_importable(objects: Iterable[object]) -> None:
    """Raise for objects of the running script or notebook, if processes lack it.

    Args:
        objects: Objects for another process, or their pickles.

    Raises:
        UsageError: If a pickle names the script.
    """
    if not _is_imported() and any(b"__main__" in _pickled(each) for each in objects):
        raise UsageError(
            "worker processes cannot import what this script or notebook defines: "
            "define it in a module, put the script's work under "
            '`if __name__ == "__main__":`, or use `workers=1`'
        )


def _pickled(value: object) -> bytes:
    """Pickle of an object; empty for what only goes to processes that start."""
    if isinstance(value, bytes):
        return value
    try:
        return pickle.dumps(value)
    except (RuntimeError, TypeError, AttributeError, pickle.PicklingError):
        return b""


def _is_imported() -> bool:
    """Whether processes import what runs: not a script without a guard, or notebook."""
    path = getattr(sys.modules["__main__"], "__file__", None)
    return path is not None and _has_guard(path)


@cache
def _has_guard(path: str) -> bool:
    """Whether a script asks what it is run as; true for what is none."""
    try:
        body = ast.parse(Path(path).read_bytes()).body
    except (OSError, SyntaxError, ValueError):
        return True
    tests = [each.test for each in body if isinstance(each, ast.If)]
    parts = [part for test in tests for part in ast.walk(test)]
    return any(isinstance(part, ast.Name) and part.id == "__name__" for part in parts)


@contextmanager
def _of_this_package() -> Iterator[None]:
    """A server started here imports this package, not one in the working folder."""
    saved = {name: os.environ.get(name) for name in (*_CHANGED, SAVED)}
    set_variables({**importing_this(), SAVED: json.dumps(saved)})
    try:
        yield
    finally:
        set_variables(saved)


def importing_this() -> dict[str, str]:
    """Environment variables with which a new Python process imports this package."""
    package = str(Path(__file__).resolve().parents[1])
    path = filter(None, (package, os.environ.get("PYTHONPATH")))
    return dict(zip(_CHANGED, ("1", os.pathsep.join(path)), strict=True))


def set_variables(values: Mapping[str, str | None]) -> None:
    """Set environment variables by name, and remove those that are None."""
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def limit_memory(more: int) -> None:
    """Let this process have so much more address space than it has now [bytes].

    Beyond it, Python raises a ``MemoryError``, and libraries fail or end the process.
    """
    pages = int(Path("/proc/self/statm").read_text("utf-8").split()[0])
    most = pages * resource.getpagesize() + more
    _limit(resource.RLIMIT_AS, most)


def limit_processor_time(seconds: int) -> None:
    """End this process with ``SIGXCPU`` once it has computed for so long.

    A busy machine, or a slow disk, takes nothing from it, unlike from a time limit.
    """
    _limit(resource.RLIMIT_CPU, seconds)


def _limit(kind: int, most: int) -> None:
    _, hard = resource.getrlimit(kind)
    if hard == resource.RLIM_INFINITY or most < hard:
        resource.setrlimit(kind, (most, hard))
