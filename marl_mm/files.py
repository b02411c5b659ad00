"""Files and folders that appear whole or not at all."""

import ctypes
import errno
import fcntl
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from marl_mm.errors import OutputExistsError, UsageError
from marl_mm.temporary import claimed, named_errors, remove
from marl_mm.words import refuse_control_characters


def home() -> Path:
    """Home folder of the user.

    Raises:
        UsageError: If there is none.
    """
    try:
        return Path.home()
    except RuntimeError as error:
        raise UsageError(f"{error} Set $HOME") from None


def is_there(path: Path) -> bool:
    """Whether there is something at a path.

    Raises:
        OSError: If that cannot be told, where ``Path.exists`` may say that there is
            nothing.
    """
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def refuse_existing(path: Path, overwrite: bool, *, file: bool = False) -> None:
    """Raise before any work is done if an output would be overwritten.

    Args:
        path: File or folder to write.
        overwrite: Whether it may be replaced.
        file: Whether it is a file, for which no folder gives way.

    Raises:
        OutputExistsError: If ``path`` exists and ``overwrite`` is False.
        UsageError: If its folder cannot be written, it is of another kind, or its name
            has a control character or begins with ``~``.
    """
    refuse_control_characters("the path", str(path))
    if path.parts[:1] == ("~",):
        raise UsageError(
            f"cannot write {path}: only shells know ~, name the home folder"
        )
    _refuse_lost_links(path, path.parent if file else path)
    above = path.absolute().parents or (path.absolute(),)  # of the root it is itself
    folder = next(parent for parent in above if parent.exists())
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise UsageError(f"cannot write {path}: {folder} is no folder open to you")
    if file and path.is_dir():
        raise UsageError(f"{path} is a folder, expected a file to write")
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise UsageError(f"cannot write {path}: it is neither a file nor a folder")
    if path.exists() and not overwrite:
        raise OutputExistsError(
            f"{path} exists already; choose another name or add `overwrite=True`"
        )


def _refuse_lost_links(path: Path, there: Path) -> None:
    """Raise a UsageError where a link on the way leads nowhere, or to itself.

    Args:
        path: File or folder to write.
        there: The part of it that no such link may be in.
    """
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error}") from None
    for place in (there, *there.parents):
        if place.is_symlink() and not place.exists():
            raise UsageError(
                f"cannot write {path}: {place} is a link to {os.readlink(place)}, "
                "which is not there"
            )


def refuse_foreign(
    folder: Path, overwrite: bool, mark: tuple[str, str], holds: Sequence[str] = ()
) -> None:
    """``refuse_existing`` of a folder that is replaced only if it is one of ours.

    Args:
        folder: Folder to write.
        overwrite: Whether it may be replaced.
        mark: Name of a file that it then has, and a text in that.
        holds: Patterns of the paths of all files in it then; empty for any.

    Raises:
        UsageError: If it may not be written.
    """
    refuse_existing(folder, overwrite)
    name, text = mark
    if folder.exists() and not (
        (folder / name).is_file() and text.encode() in (folder / name).read_bytes()
    ):
        raise UsageError(
            f"{folder} has no {name} of marl-mm and is not replaced: choose another "
            "name"
        )
    within = folder.rglob("*") if holds else ()
    files = (path for path in within if not (path.is_dir() and any(path.iterdir())))
    for inner in sorted(path.relative_to(folder).as_posix() for path in files):
        if not any(fnmatch(inner, pattern) for pattern in holds):
            raise UsageError(
                f"{folder} holds {inner}, which is not of marl-mm, and is not "
                "replaced: move that, or choose another name"
            )


def refuse_input(folder: Path, inputs: Iterable[Path]) -> None:
    """Raise before a folder is written that holds what it is made of, or lies in it.

    Raises:
        UsageError: Naming the input.
    """
    target = folder.resolve()
    for path in (path.resolve() for path in inputs):
        if target.is_relative_to(path) or path.is_relative_to(target):
            raise UsageError(
                f"{folder} would be written over or into {path}, which it is made of: "
                "choose another name"
            )


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """A temporary name beside ``path``, renamed to it when the block succeeds.

    Of a link it is the file that is replaced, not the link. The temporary file exists
    and is empty.

    Raises:
        OSError: If there is no room or no permission; it names ``path``.
    """
    path = path.resolve() if path.is_symlink() else path
    path.parent.mkdir(parents=True, exist_ok=True)
    with claimed(path, path.stem, f".part{path.suffix}", Path.touch) as temporary:
        try:
            with named_errors(path, temporary):
                yield temporary
                _to_disk(temporary)
                temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A temporary folder beside ``path`` that takes its place when the block succeeds.

    The folder that it replaces is deleted after that, of a link the folder that it
    leads to. One of the two is always there, on file systems that can exchange two
    names.

    Raises:
        OSError: If there is no room or no permission; it names ``path`` or what is in
            it.
    """
    path = path.resolve() if path.is_symlink() else path.absolute()  # "." has no name
    path.parent.mkdir(parents=True, exist_ok=True)
    with claimed(path, path.name, ".new", Path.mkdir) as temporary:
        try:
            with named_errors(path, temporary):
                yield temporary
                for inner in (*temporary.rglob("*"), temporary):
                    _to_disk(inner)
                try:
                    temporary.rename(path)
                except OSError as error:
                    if error.errno not in _THERE:
                        raise
                    _exchange(temporary, path)
                _to_disk(path.parent)
        finally:
            remove(temporary)


_THERE = errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR
"""Errors of renaming a folder where something has its new name."""


def _to_disk(path: Path) -> None:
    """Wait until a file's bytes, or a folder's names, are safe from a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _exchange(new: Path, old: Path) -> None:
    """Exchange the names of two paths, in one step where the file system can."""
    libc = ctypes.CDLL(None)
    here, exchange = -100, 2  # AT_FDCWD, RENAME_EXCHANGE
    renameat2 = getattr(libc, "renameat2", None)  # which musl may lack
    if not renameat2 or renameat2(here, bytes(new), here, bytes(old), exchange):
        between = new.with_suffix(".old")  # network file systems cannot
        old.rename(between)
        new.rename(old)
        between.rename(new)


@contextmanager
def only_here(folder: Path, *, wait: bool = False) -> Iterator[None]:
    """Lock a folder against other processes that call this; it is created.

    The operating system unlocks it when the process ends, however it ends.

    Args:
        folder: Folder that is written in the block.
        wait: Whether to wait until the folder is free instead of raising.

    Raises:
        UsageError: If another process has locked it.
    """
    descriptor = -1
    try:
        while descriptor < 0:
            descriptor = _opened(folder)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                raise UsageError(
                    f"another process is writing {folder}: wait for it, or choose "
                    "another"
                ) from None
            if not _is_open_at(descriptor, folder):  # the last owner removed it
                os.close(descriptor)
                descriptor = -1
        yield
    finally:
        if descriptor >= 0:
            os.close(descriptor)


def _opened(folder: Path) -> int:
    """A descriptor of a folder, which is created if it is missing."""
    while True:  # another process may remove it after each line
        _refuse_lost_links(folder, folder)
        with suppress(FileExistsError):
            folder.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            return os.open(folder, os.O_RDONLY | os.O_DIRECTORY)


def _is_open_at(descriptor: int, folder: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), folder.stat())
    except FileNotFoundError:
        return False


def append(path: Path, data: bytes) -> None:
    """Append bytes to a file, all or none.

    Raises:
        OSError: If there is no room or no permission; it names the file.
    """
    new = not is_there(path)
    with named_errors(path), path.open("ab", buffering=0) as file:
        before = file.tell()
        try:
            written = file.write(data)
            while written < len(data):  # a write that comes to a limit is cut there
                written += file.write(data[written:])
            os.fsync(file.fileno())
        except OSError:
            file.truncate(before)
            if new:
                path.unlink()
            raise


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as indented JSON; see ``write_bytes``."""
    write_bytes(path, (json.dumps(value, indent=2) + "\n").encode())


def write_bytes(path: Path, data: bytes | memoryview) -> None:
    """Write a file, atomically.

    Raises:
        OSError: If there is no room or no permission; it names the file.
    """
    with new_file(path) as temporary:
        temporary.write_bytes(data)
