"""Temporary files and folders, and errors of writing that do not name them."""

import errno
import fcntl
import hashlib
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path


@contextmanager
def named_errors(path: Path, temporary: Path | None = None) -> Iterator[None]:
    """Let errors of the operating system in the block name the file that is written.

    A write to an open file fails without a name, as on a full disk.

    Args:
        path: Name for errors that have none.
        temporary: Other name of ``path`` in the block, which nobody knows.

    Raises:
        OSError: Those of the block.
    """
    try:
        yield
    except OSError as error:
        name = error.filename
        if error.errno is None:  # a library's own, in words
            raise OSError(errno.EIO, str(error), str(path)) from error
        if name is None:
            error.filename = str(path)
        elif temporary is not None and isinstance(name, str | Path):
            if Path(name).is_relative_to(temporary):
                error.filename = str(path / Path(name).relative_to(temporary))
        raise


def remove_left(folder: Path, name: str, ending: str) -> None:
    """Delete what killed processes left in a folder; see ``claimed``."""
    for other in os.listdir(folder):
        writer = other.removeprefix(f".{name}.").removesuffix(ending)
        if other == f".{name}.{writer}{ending}" and _WRITER.fullmatch(writer):
            _remove_if_left(folder / other, writer[:8])


@contextmanager
def claimed(
    path: Path, name: str, ending: str, make: Callable[[Path], None]
) -> Iterator[Path]:
    """A new file or folder beside a path that others leave alone during the block.

    It is locked, by which they tell it from what a killed process left. That goes.

    Args:
        path: The path beside it.
        name: Name that it begins with, after a dot.
        ending: Ending of its name.
        make: Function that makes it.
    """
    remove_left(path.parent, name, ending)
    descriptor = -1
    try:
        while descriptor < 0:
            writer = f"{_machine()}{secrets.token_hex(4)}"
            temporary = path.with_name(f".{name}.{writer}{ending}")
            with named_errors(path, temporary):
                make(temporary)
            with suppress(FileNotFoundError, BlockingIOError):  # taken for dead
                descriptor = _locked(temporary)
        yield temporary
    finally:
        if descriptor >= 0:
            os.close(descriptor)


_WRITER = re.compile(r"[0-9a-f]{16}")
"""Machine and number of the writer in the name of a temporary file."""

_DAY = 86_400
"""Time after which a temporary file of another machine, or of this one before it was
started again, counts as left [s]."""


@cache
def _machine() -> str:
    """Eight hex digits that a machine has from one start to the next."""
    started = Path("/proc/sys/kernel/random/boot_id").read_bytes()
    return hashlib.sha256(started).hexdigest()[:8]


def _remove_if_left(temporary: Path, machine: str) -> None:
    """Delete a temporary file of a process that has ended."""
    with suppress(OSError):  # it is locked, or gone
        if machine != _machine():
            if time.time() - temporary.stat().st_mtime > _DAY:
                remove(temporary)
            return
        descriptor = _locked(temporary)
        try:
            remove(temporary)  # before another may lock it
        finally:
            os.close(descriptor)


def _locked(path: Path) -> int:
    """Descriptor of a file or folder, which is locked until that is closed.

    Raises:
        BlockingIOError: If another process, or thread, has locked it.
        FileNotFoundError: If it is gone.
    """
    kind = os.O_DIRECTORY if path.is_dir() else os.O_RDWR
    descriptor = os.open(path, kind)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        path.stat()
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def remove(path: Path) -> None:
    """Delete a file, a link or a folder, as far as that is possible."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
