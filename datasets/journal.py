"""Journal of a collection in progress, which stores each finished episode durably.

It is an SQLite file in a folder beside the dataset. Whatever kills the collection, the
journal holds all episodes that were finished before. It is deleted when the dataset is
complete.
"""

import hashlib
import io
import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from marl_mm.datasets.arrays import arrays_of, load_arrays, save_arrays
from marl_mm.datasets.location import datasets_root
from marl_mm.episode import Episode
from marl_mm.errors import DatasetError, MarlMmError
from marl_mm.layout import Layout
from marl_mm.received import check_kind, check_regular, parse_json

FILE = "episodes.sqlite"

_DIGEST = "record_sha256"
"""Key of the record's checksum."""


def begun() -> dict[str, int | None]:
    """Numbers of episodes in all unfinished collections below the root, by id.

    A number is None if its journal cannot be read.
    """
    root = datasets_root()
    counts = {}
    for path in root.glob(f"**/.*.collecting/{FILE}") if root.exists() else []:
        folder = path.parent
        name = folder.with_name(folder.name[1:].removesuffix(".collecting"))
        counts[name.relative_to(root).as_posix()] = _asked(
            folder, "select count(*) from episodes"
        )
    return dict(sorted(counts.items()))


def noted(folder: Path) -> dict[str, Any] | None:
    """The record of a collection; None if nothing was begun, or it cannot be read."""
    text = _asked(folder, "select text from about")
    return None if text is None else _record(text, folder / FILE)


def _record(text: Any, path: Path) -> dict[str, Any]:
    if not isinstance(text, str):
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


def _asked(folder: Path, question: str) -> Any:
    """A value from a journal that another process may be writing."""
    address = f"{(folder / FILE).absolute().as_uri()}?mode=rw"  # does not create it
    try:
        with closing(sqlite3.connect(address, uri=True)) as file:
            _refuse_programs(file, folder / FILE)
            row = file.execute(question).fetchone()
    except (sqlite3.DatabaseError, DatasetError):
        return None
    return None if row is None else row[0]


def _refuse_programs(file: sqlite3.Connection, path: Path) -> None:
    """Raise for a file whose tables are computed when they are read."""
    question = "select count(*) from sqlite_master where type not in ('table', 'index')"
    if file.execute(question).fetchone()[0]:
        raise DatasetError(f"{path} is damaged: it holds more than tables")


class Journal:
    """Finished episodes by number; use it in a ``with`` block.

    Args:
        folder: Folder of the journal, which is created.

    Raises:
        DatasetError: If the existing journal is damaged.
        MarlMmError: If the journal cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / FILE
        if self._path.exists():
            check_regular(self._path, DatasetError)
        with self._errors():
            self._file = sqlite3.connect(self._path)
            _refuse_programs(self._file, self._path)
            self._file.execute("create table if not exists about (text)")
            self._file.execute(
                "create table if not exists episodes (number integer primary key, npz)"
            )

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def about(self) -> dict[str, Any] | None:
        """The record of the collection; None if nothing was begun."""
        with self._errors():
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
        with self._errors():
            (count,) = self._file.execute("select count(*) from episodes").fetchone()
        return int(count)

    def episodes(self, layout: Layout) -> dict[int, Episode]:
        """All episodes by number.

        Args:
            layout: Layout of the states and actions.
        """
        with self._errors():
            rows = self._file.execute("select number, npz from episodes").fetchall()
        try:
            episodes = [load_arrays(io.BytesIO(blob), layout) for _, blob in rows]
            if [int(e.indices[0]) for e in episodes] != [number for number, _ in rows]:
                raise ValueError("an episode of another number")
            return {int(arrays.indices[0]): arrays.episode(0) for arrays in episodes}
        except (DatasetError, TypeError, ValueError) as error:
            raise DatasetError(
                f"an episode in {self._path} is damaged: start anew with "
                "`overwrite=True`"
            ) from error

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
            raise DatasetError(
                f"{self._path} is damaged ({error}): start anew with `overwrite=True`"
            ) from error
