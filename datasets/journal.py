"""Journal of a collection in progress, which stores each finished episode durably.

It is an SQLite file in a folder beside the dataset. Whatever kills the collection, the
journal holds all episodes that were finished before. It is deleted when the dataset is
complete.
"""

import hashlib
import io
import json
import sqlite3
from collections.abc import Generator, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from marl_mm.datasets.arrays import arrays_of, load_arrays, save_arrays
from marl_mm.datasets.location import datasets_root, found
from marl_mm.datasets.sqlite_files import check_files, check_tables, opened_to_read
from marl_mm.episode import Episode
from marl_mm.errors import DatasetError, MarlMmError
from marl_mm.layout import Layout
from marl_mm.received import RECORD_BYTES, check_kind, parse_json

FILE = "episodes.sqlite"

_DIGEST = "record_sha256"
"""Key of the record's checksum."""


_LEAST_LIMIT = 100_000
"""Smallest limit of SQLite's values [bytes], whose statements count too."""

_TABLES = {
    "about": "CREATE TABLE about (text)",
    "episodes": "CREATE TABLE episodes (number integer primary key, npz)",
}
"""Statements that create the tables, as SQLite keeps them; no others may be there."""


def begun() -> dict[str, int | None]:
    """Numbers of episodes in all unfinished collections below the root, by id.

    A number is None if its journal cannot be read.
    """
    root = datasets_root()
    counts: dict[str, int | None] = {}
    folders = (path.parent for path in found(FILE))
    for folder in (each for each in folders if each.match(".*.collecting")):
        name = folder.with_name(folder.name[1:].removesuffix(".collecting"))
        count = None
        with suppress(MarlMmError), reading(folder) as journal:
            count = len(journal)
        counts[name.relative_to(root).as_posix()] = count
    return dict(sorted(counts.items()))


def noted(folder: Path) -> dict[str, Any] | None:
    """The record of a collection; None if nothing was begun, or it cannot be read."""
    if not (folder / FILE).exists():
        return None
    with suppress(MarlMmError), reading(folder) as journal:
        return journal.about()
    return None


@contextmanager
def reading(folder: Path) -> Iterator["Journal"]:
    """A journal that another process may be writing; no file is changed.

    Raises:
        DatasetError: If it is damaged, missing, or could change other files.
    """
    path = folder / FILE
    with _read_errors(path), opened_to_read(path) as file:
        check_tables(file, path, _TABLES)
        yield Journal(folder, file)


@contextmanager
def _read_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.OperationalError as error:  # no permission, no such table
        raise DatasetError(f"cannot read {path}: {error}") from error
    except sqlite3.DatabaseError as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: sqlite3.DatabaseError) -> DatasetError:
    return DatasetError(
        f"{path} is damaged ({error}): start anew with `overwrite=True`"
    )


def _record(text: Any, path: Path) -> dict[str, Any]:
    if not isinstance(text, str) or len(text) > RECORD_BYTES:
        raise DatasetError(f"{path} is damaged: its record is {text!r:.60}")
    value = parse_json(text, str(path), DatasetError)
    check_kind(value, dict[str, Any], str(path), DatasetError)
    record: dict[str, Any] = value
    if record.pop(_DIGEST, None) not in (None, _digest(record)):  # version 1 has none
        raise DatasetError(f"{path} is damaged: its record is not as it was written")
    return record


def _digest(record: Mapping[str, Any]) -> str:
    text = json.dumps(record, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def discard(folder: Path) -> None:
    """Delete a journal, whatever it is, and what SQLite left beside it.

    Raises:
        OSError: If that is not allowed.
    """
    for path in folder.glob(f"{FILE}*"):
        path.unlink()


class Journal:
    """Finished episodes by number; use it in a ``with`` block.

    Args:
        folder: Folder of the journal, which is created.
        opened: The journal's file, opened to be read alone; see ``reading``.

    Raises:
        DatasetError: If the existing journal is damaged, or could change other files.
        MarlMmError: If the journal cannot be written.
    """

    def __init__(self, folder: Path, opened: sqlite3.Connection | None = None) -> None:
        self._path = folder / FILE
        if opened is not None:
            self._file = opened
            return
        folder.mkdir(parents=True, exist_ok=True)
        check_files(self._path)
        with self._errors(), ExitStack() as failing:
            self._file = sqlite3.connect(self._path)
            failing.callback(self._file.close)
            check_tables(self._file, self._path, _TABLES)
            there = {n for (n,) in self._file.execute("select name from sqlite_master")}
            for statement in (_TABLES[name] for name in _TABLES if name not in there):
                self._file.execute(statement)
            failing.pop_all()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def about(self) -> dict[str, Any] | None:
        """The record of the collection; None if nothing was begun."""
        with self._reading():
            row = self._file.execute("select text from about").fetchone()
        return None if row is None else _record(row[0], self._path)

    def begin(self, about: dict[str, Any]) -> None:
        """Delete everything and store the record of a collection."""
        with self._errors(), self._file:
            self._file.execute("delete from episodes")
        self.note(about)

    def note(self, about: dict[str, Any]) -> None:
        """Store the record of the collection, and keep the episodes."""
        with self._errors(), self._file:
            self._file.execute("delete from about")
            text = json.dumps(
                {**about, _DIGEST: _digest(json.loads(json.dumps(about)))}
            )
            self._file.execute("insert into about values (?)", [text])

    def add(self, episode: Episode) -> None:
        """Store an episode; when this returns, it is on the disk."""
        blob = io.BytesIO()
        save_arrays(blob, arrays_of([episode], ""), compress=False)
        with self._errors(), self._file:
            self._file.execute(
                "insert or replace into episodes values (?, ?)",
                [episode.index, blob.getvalue()],
            )

    def __len__(self) -> int:
        return sum(1 for _ in self._rows("select number from episodes"))

    def episodes(self, layout: Layout) -> dict[int, Episode]:
        """All episodes by number.

        Args:
            layout: Layout of the states and actions.

        Raises:
            DatasetError: If an episode is damaged, or larger than it should be.
        """
        episodes: dict[int, Episode] = {}
        left = self._path.stat().st_size
        question = "select number, npz from episodes"
        with closing(self._rows(question)) as rows:
            for number, blob in rows:
                try:
                    left -= len(blob)
                    if left < 0:  # several are made of the same bytes
                        raise ValueError("more episodes than the file has room for")
                    arrays = load_arrays(io.BytesIO(blob), layout, packed=False)
                    if int(arrays.indices[0]) != number:
                        raise ValueError("an episode of another number")
                    episodes[number] = arrays.episode(0)
                except (DatasetError, TypeError, ValueError) as error:
                    raise DatasetError(
                        f"an episode in {self._path} is damaged: start anew with "
                        "`overwrite=True`"
                    ) from error
        return episodes

    def _rows(self, question: str) -> Generator[tuple[Any, ...], None, None]:
        """Rows by rising number: in a file that was forged they could go on forever."""
        with self._reading():
            before = None
            for row in self._file.execute(question):
                if before is not None and row[0] <= before:
                    raise DatasetError(f"{self._path} is damaged: its rows repeat")
                before = row[0]
                yield row

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """No value is larger than the file, whatever it says of itself."""
        most = max(self._path.stat().st_size, _LEAST_LIMIT)
        usual = self._file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, most)
        try:
            with _read_errors(self._path):
                yield
        finally:
            self._file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, usual)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.OperationalError as error:  # disk full, no permission
            raise MarlMmError(
                f"cannot write {self._path}: {error}; finished episodes are kept: make "
                "room and go on with `resume=True`"
            ) from error
        except sqlite3.DatabaseError as error:
            raise _damaged(self._path, error) from error
