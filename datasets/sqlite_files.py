"""SQLite files that may come from strangers: opened so that no other file changes.

SQLite believes what lies beside a database. It plays a rollback journal back, and then
deletes the file that the journal's end names as a super-journal, wherever that is.
Journals of a single database, such as ours, name none.
"""

import shutil
import sqlite3
import struct
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from marl_mm.errors import DatasetError
from marl_mm.received import check_regular

_ROLLBACK = "-journal"
"""Suffix of the file that undoes a transaction which was cut off."""

_WRITE_AHEAD = ("-wal", "-shm")
"""Suffixes of files of another way to keep transactions, which we do not use."""

_MAGIC = bytes.fromhex("d9d505f920a163d7")
"""Beginning of a rollback journal, and the end of one that names a super-journal."""

_HEADER = struct.Struct(">8s8xIII")
"""Of a rollback journal: magic, pages of the database before, sector and page size."""

_COPIED_BYTES = 4_000_000_000
"""Largest size of a database that is copied to undo a transaction [bytes]."""


def check_files(path: Path) -> None:
    """Raise for a database whose opening could change other files.

    One that does not exist yet is fine.

    Raises:
        DatasetError: If it or its rollback journal is a link or no regular file, the
            journal names another file or undoes to a larger size, or the database
            keeps transactions in another way than ours do.
    """
    rollback = path.with_name(path.name + _ROLLBACK)
    for file in (path, rollback):
        if file.is_symlink():
            raise DatasetError(
                f"{file} is a link to {file.resolve()}: put a copy of the file there "
                "instead"
            )
    size, ways = 0, b""
    if path.exists():
        size = check_regular(path, DatasetError)
        with path.open("rb") as database:
            ways = database.read(20)[18:]
    beside = [path.with_name(path.name + suffix) for suffix in _WRITE_AHEAD]
    if ways not in (b"", b"\1\1") or any(map(_is_there, beside)):
        raise DatasetError(f"{path} is damaged: it has, or asks for, a write-ahead log")
    if _is_there(rollback):
        _check_rollback(rollback, size)


def _is_there(path: Path) -> bool:
    return path.exists() or path.is_symlink()


def _check_rollback(path: Path, database_size: int) -> None:
    size = check_regular(path, DatasetError)
    with path.open("rb") as file:
        head = file.read(_HEADER.size)
        file.seek(max(size - len(_MAGIC), 0))
        end = file.read()
    if size > len(_MAGIC) and end == _MAGIC:
        raise DatasetError(
            f"{path} names another file, which SQLite would delete: "
            "start anew with `overwrite=True`"
        )
    if len(head) == _HEADER.size:
        magic, pages, _, page_size = _HEADER.unpack(head)
        if magic == _MAGIC and pages * page_size > database_size:
            raise DatasetError(
                f"{path} is damaged: it undoes to {pages * page_size:,} bytes, the "
                f"database has {database_size:,}"
            )


@contextmanager
def opened_to_read(path: Path) -> Iterator[sqlite3.Connection]:
    """A database that another process may be writing; no file is changed.

    Of a transaction that was cut off, a private copy is undone.

    Raises:
        DatasetError: See ``check_files``.
        sqlite3.DatabaseError: If it cannot be read.
    """
    check_files(path)
    with ExitStack() as opened:
        file = opened.enter_context(_connected(path, "ro"))
        if _is_cut_off(file):
            check_regular(path, DatasetError, _COPIED_BYTES)
            folder = opened.enter_context(TemporaryDirectory())
            for name in (path.name, path.name + _ROLLBACK):
                shutil.copy(path.with_name(name), folder)
            file = opened.enter_context(_connected(Path(folder, path.name), "rw"))
        yield file


def _connected(path: Path, mode: str) -> "closing[sqlite3.Connection]":
    address = f"{path.absolute().as_uri()}?mode={mode}"
    return closing(sqlite3.connect(address, uri=True))


def _is_cut_off(file: sqlite3.Connection) -> bool:
    try:
        file.execute("select count(*) from sqlite_master").fetchone()
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode == sqlite3.SQLITE_READONLY_ROLLBACK:
            return True
        raise
    return False


def check_tables(
    file: sqlite3.Connection, path: Path, tables: Mapping[str, str]
) -> None:
    """Raise for a database with anything else than these tables.

    Views, triggers and generated columns are computed when they are read.

    Args:
        file: The database.
        path: Its path, for messages.
        tables: Statement that creates each table, by name.

    Raises:
        DatasetError: If there is something else.
        sqlite3.DatabaseError: If it cannot be read.
    """
    for name, statement in file.execute("select name, sql from sqlite_master"):
        if tables.get(name) != statement:
            raise DatasetError(
                f"{path} is damaged: it holds {name!a:.40}, expected the tables "
                f"{' and '.join(tables)} as they were made"
            )
