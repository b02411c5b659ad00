"""Checks of torch's archives before torch reads them."""

import pickletools
import re
import zipfile
from pathlib import Path
from typing import Any

from marl_mm.received import MAX_VALUES, most_unpacked

PICKLE_BYTES = 250_000
"""Largest size of a checkpoint's structure [bytes]; those of eight algorithms have at
most 22,000, as numbers lie in other parts."""

_MOST_PARTS = 5_000
"""Largest number of parts of an archive; ours have at most 222."""

_NUMBERS = re.compile(r"[^/]+/data/\d+")
"""Names of the parts that hold a tensor's numbers."""

_BEGIN = b"PK\x03\x04"
"""First bytes of a zip archive; torch reads any other file in its former format."""


def check_archive(file: Path) -> None:
    """Raise for a zip archive of torch that is not as torch writes them.

    torch does not look at the checksums: a bit that flips would go unnoticed.

    Raises:
        ValueError, zipfile.BadZipFile, ...: Naming what is wrong.
    """
    with zipfile.ZipFile(file) as archive:
        _check_parts(archive, file.stat().st_size)


def check_saved(file: Path) -> None:
    """Raise for a file that ``torch.save`` did not write, or that would burst.

    A structure of a few bytes can stand for any number of values, and torch builds all
    of them before it looks at any.

    Raises:
        ValueError, zipfile.BadZipFile, ...: Naming what is wrong.
    """
    with file.open("rb") as opened:
        if opened.read(len(_BEGIN)) != _BEGIN:
            raise ValueError("it does not begin as a zip archive")
    with zipfile.ZipFile(file) as archive:
        for part in archive.infolist():
            where = f"{part.filename[:30]!a}"
            if part.compress_type != zipfile.ZIP_STORED:
                raise ValueError(f"{where} is compressed")
            most = part.file_size if _NUMBERS.fullmatch(part.filename) else PICKLE_BYTES
            if part.file_size > most:
                size = f"{part.file_size:,} bytes, expected at most {most:,}"
                raise ValueError(f"{where} has {size}")
        _check_parts(archive, file.stat().st_size)
        for name in archive.namelist():
            if name.lower().endswith("data.pkl"):
                _check_pickle(archive.read(name))


def _check_parts(archive: zipfile.ZipFile, size: int) -> None:
    """Raise for parts that are too many, too large or damaged in a file of a size."""
    parts = archive.infolist()
    if len(parts) > _MOST_PARTS:
        raise ValueError(f"{len(parts):,} parts, expected at most {_MOST_PARTS:,}")
    if len({part.filename for part in parts}) < len(parts):
        raise ValueError("two parts of one name")
    unpacked = sum(part.file_size for part in parts)
    if unpacked > most_unpacked(size):
        raise ValueError(f"{unpacked:,} bytes unpacked")
    if (damaged := archive.testzip()) is not None:
        raise ValueError(f"checksum of {damaged}")


def _check_pickle(content: bytes) -> None:
    """Raise for a pickle of more values than a record may hold.

    A value that stands in several places counts each time, as the hash of a tuple looks
    at it each time. Nothing is built: the operations are counted.
    """
    stack: list[list[int]] = []  # each value's count in a list, as containers grow
    memo: dict[Any, list[int]] = {}
    marks: list[int] = []
    for operation, argument, _ in pickletools.genops(content):
        name = operation.name
        if name == "PROTO" and argument != 2:
            raise ValueError(f"a pickle of protocol {argument}, torch writes 2")
        if name == "MARK":
            marks.append(len(stack))
        elif "PUT" in name:
            memo[argument] = stack[-1]
        elif name == "MEMOIZE":
            memo[len(memo)] = stack[-1]
        elif "GET" in name:
            stack.append(memo[argument])
        else:
            taken, given = operation.stack_before, operation.stack_after
            if pickletools.markobject in taken:
                begin = marks.pop() - taken.index(pickletools.markobject)
            else:
                begin = len(stack) - len(taken)
            if begin < 0:
                raise ValueError("a pickle that takes more than it has")
            values = stack[begin:]
            del stack[begin:]
            count = 1 + sum(value[0] for value in values)
            if count > MAX_VALUES:
                raise ValueError(f"more than {MAX_VALUES:,} values")
            if name in _GROWING:
                values[0][0] = count
                stack.append(values[0])
            else:
                stack += [[count] for _ in given]


_GROWING = ("APPEND", "APPENDS", "SETITEM", "SETITEMS", "ADDITEMS", "BUILD")
"""Operations that change a container and leave it where it is."""
