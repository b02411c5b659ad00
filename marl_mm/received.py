"""Reading of files that may come from strangers: each is checked before it is read.

A pipe or a device would never end, a link can lead anywhere, and a small file can ask
for more memory than there is.
"""

import hashlib
import json
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

from typeguard import CollectionCheckStrategy, TypeCheckError, check_type

from marl_mm.errors import MarlMmError
from marl_mm.words import is_harmless

RECORD_BYTES = 16_000_000
"""Largest size of a record in JSON [bytes]; ours have a few thousand."""

MAX_VALUES = 3_000_000
"""Largest number of values in a record, containers included."""

_MAX_DEPTH = 60
"""Largest depth of containers in a record."""

Refusal = type[MarlMmError]
"""Class of the error that is raised."""


def check_regular(path: Path, refusal: Refusal, most: int | None = None) -> int:
    """Size of a regular file, or of the one that a link leads to [bytes].

    Args:
        path: The file.
        refusal: Class of the error.
        most: Largest size [bytes]; None: any.

    Raises:
        MarlMmError: If it is missing, something else than a file, or too large.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:  # a null character is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise refusal(f"cannot read {path}: {reason}") from error
    if not stat.S_ISREG(status.st_mode):
        raise refusal(f"{path} is {_kind(status.st_mode)}, expected a regular file")
    if most is not None and status.st_size > most:
        raise refusal(f"{path} has {status.st_size:,} bytes, expected at most {most:,}")
    return status.st_size


def _kind(mode: int) -> str:
    if stat.S_ISDIR(mode):
        return "a folder"
    return "a pipe" if stat.S_ISFIFO(mode) else "a device or a socket"


def refuse_links_out(folder: Path, names: Iterable[str], refusal: Refusal) -> None:
    """Raise for a path in a folder that leads out of it.

    Args:
        folder: The folder; it may be a link itself.
        names: Paths in the folder; those that do not exist are passed over.
        refusal: Class of the error.

    Raises:
        MarlMmError: Naming the link and where it leads.
    """
    home = folder.resolve()
    for name in names:
        path = folder / name
        try:
            target = path.resolve(strict=os.path.lexists(path))
        except (OSError, RuntimeError) as error:  # RuntimeError: before Python 3.13
            raise refusal(f"{path} is a link that leads nowhere: {error}") from error
        if not target.is_relative_to(home):
            raise refusal(
                f"{path} is a link out of its folder, to {target}: put a copy of the "
                "file there instead"
            )


def read_text(path: Path, refusal: Refusal, most: int = RECORD_BYTES) -> str:
    """The text of a regular file, in UTF-8.

    Raises:
        MarlMmError: If it cannot be read, or is too large.
    """
    check_regular(path, refusal, most)
    try:
        return path.read_text("utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise refusal(f"cannot read {path}: {reason}") from error


def read_json(path: Path, refusal: Refusal, most: int = RECORD_BYTES) -> Any:
    """The value in a JSON file.

    Raises:
        MarlMmError: If it cannot be read, is too large or nested too deeply, or holds
            control characters.
    """
    return parse_json(read_text(path, refusal, most), str(path), refusal)


def parse_json(text: str, where: str, refusal: Refusal) -> Any:
    """The value of a JSON text.

    Args:
        text: The text.
        where: Name of its source, for messages.
        refusal: Class of the error.

    Raises:
        MarlMmError: If it is no JSON, nested too deeply, or holds control characters.
    """
    if sum(map(text.count, ",[{")) > MAX_VALUES:  # before memory is spent on them
        raise refusal(f"{where} has more than {MAX_VALUES:,} values")
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise refusal(f"{where} is damaged ({error})") from error
    check_plain(value, where, refusal)
    return value


def check_plain(
    value: Any, where: str, refusal: Refusal, other: Callable[[Any], None] | None = None
) -> None:
    """Raise for a value whose text could not be shown.

    Such values are too large, nested too deeply, or hold control characters. A
    container that stands in several places counts each time: its text would repeat it.

    Args:
        value: Value of a record.
        where: Name of its source, for messages.
        refusal: Class of the error.
        other: Function that is called with each value of another type than JSON's.

    Raises:
        MarlMmError: Naming what is wrong.
    """
    levels: list[Iterator[Any]] = [iter((value,))]
    count = 0
    while levels:
        for inner in levels[-1]:
            count += 1
            if count > MAX_VALUES or len(levels) > _MAX_DEPTH + 1:
                raise refusal(
                    f"{where} has more than {MAX_VALUES:,} values, or more than "
                    f"{_MAX_DEPTH} levels of them"
                )
            if isinstance(inner, str) and not is_printable(inner):
                raise refusal(f"{where} holds control characters: {inner[:60]!a}")
            if isinstance(inner, dict):
                levels.append(chain.from_iterable(inner.items()))
                break
            if isinstance(inner, list | tuple | set | frozenset):
                levels.append(iter(inner))
                break
            if other is not None:
                other(inner)
        else:
            levels.pop()


def check_kind(value: Any, kind: Any, where: str, refusal: Refusal) -> None:
    """Raise for a value of another type, its inner values included.

    Args:
        value: Value of a record.
        kind: Type that it must have, such as ``dict[str, int]``.
        where: Name of the record's source, for messages.
        refusal: Class of the error.

    Raises:
        MarlMmError: Naming the part that is of another type.
    """
    every = CollectionCheckStrategy.ALL_ITEMS
    try:
        check_type(value, kind, collection_check_strategy=every)
    except TypeCheckError as error:
        reason = " ".join(str(error).split())
        raise refusal(f"{where}: {reason:.200}") from None


def printable(text: str) -> str:
    """A text with its control characters spelled out, for terminals."""
    return "".join(c if is_printable(c) else ascii(c)[1:-1] for c in text)


def printable_name(name: str) -> str:
    """A name with all its control characters spelled out, line breaks too."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in name)


_ODD = (LookupError, TypeError, ValueError, AttributeError, ArithmeticError)
"""Exceptions at values of the wrong kind."""


@contextmanager
def damage_named(where: str, refusal: Refusal) -> Iterator[None]:
    """Turn the errors of a block that meets odd values into one of the package's.

    Args:
        where: Name of the values' source, for messages.
        refusal: Class of the error.

    Raises:
        MarlMmError: If the block raises an error at values of the wrong kind.
    """
    try:
        yield
    except MarlMmError:
        raise
    except _ODD as error:
        reason = " ".join(f"{error!r}".split())
        raise refusal(f"{where} is damaged ({reason:.100})") from error


def is_printable(text: str) -> bool:
    """Whether a text can do no harm in a terminal; it may have several lines."""
    return text.isprintable() or all(
        c in "\n\t\u2028\u2029" or is_harmless(c) for c in set(text)
    )


def file_digest(path: Path, refusal: Refusal) -> str:
    """SHA-256 of a regular file's bytes, in hex digits.

    Raises:
        MarlMmError: If it cannot be read.
    """
    check_regular(path, refusal)
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise refusal(f"cannot read {path}: {error.strerror}") from error


def most_unpacked(size: int) -> int:
    """Largest size of the contents that a file of this size may hold [bytes].

    Ours are compressed to a fifth at best: beyond that, a file is a trap.
    """
    return 64_000_000 + 10 * size
