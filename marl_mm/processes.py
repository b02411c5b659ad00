"""Worker processes that are forked from a server with the imports done.

They start in milliseconds instead of seconds, and share the libraries' memory.
"""

import json
import os
import resource
import sys
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
    if (path := _unguarded_script()) is None:
        yield
        return
    main = sys.modules["__main__"]
    del main.__file__
    try:
        yield
    finally:
        main.__file__ = path


def check_importable(objects: Iterable[object]) -> None:
    """Raise for objects of the running script, if processes do not import it.

    Args:
        objects: Objects for another process, or their pickles.

    Raises:
        UsageError: If one is of the script, or its pickle names the script.
    """
    if _unguarded_script() is None:
        return
    for each in objects:
        of_pickle = isinstance(each, bytes) and b"__main__" in each
        if of_pickle or type(each).__module__ == "__main__":
            raise UsageError(
                "worker processes need what the script defines, but cannot import it: "
                'put the script\'s work under `if __name__ == "__main__":`, or use '
                "`workers=1`"
            )


def _unguarded_script() -> str | None:
    """Path of the running script if it does not ask what it is run as."""
    path = getattr(sys.modules["__main__"], "__file__", None)
    return (
        path
        if path and path.endswith(".py") and "__name__" not in _text(path)
        else None
    )


@cache
def _text(path: str) -> str:
    return Path(path).read_text(errors="replace")


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
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + more
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard == resource.RLIM_INFINITY or most < hard:
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
