"""The journal keeps every finished episode, whatever happens to its writer."""

import io
import signal
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from marl_mm.datasets.arrays import arrays_of, save_arrays
from marl_mm.datasets.journal import FILE, Journal, begun, discard, noted, reading
from marl_mm.datasets.location import locate
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.errors import DatasetError

MakeEpisode = Callable[..., Episode]

WRITER = """
import os, resource, signal, sys
from dataclasses import replace
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from conftest import build_episode
from marl_mm.datasets.journal import Journal
if sys.argv[3] == "full":
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
with Journal(Path(sys.argv[2])) as journal:
    journal.begin({"seed": 0})
    for i in range(100):
        journal.add(build_episode(i))
        print(i, flush=True)
        if sys.argv[3] == "kill" and i == 6:
            os.kill(os.getpid(), signal.SIGKILL)
"""


def write(folder: Path, how: str) -> "subprocess.CompletedProcess[str]":
    tests = str(Path(__file__).parents[1])
    return subprocess.run(
        [sys.executable, "-c", WRITER, tests, str(folder), how],
        capture_output=True,
        text=True,
        check=False,
    )


def test_collections_under_way_are_counted(
    datasets_home: Path, make_episode: MakeEpisode
) -> None:
    """Also while they are written; and nothing is created where nothing is."""
    folder = locate("one").working
    with Journal(folder) as journal:
        journal.begin({"seed": 3})
        journal.add(make_episode(0))
        assert begun() == {"marl_mm/reach/one-v0": 1}
        assert noted(folder) == {"seed": 3}
    damaged = locate("two").working
    damaged.mkdir()
    (damaged / FILE).write_bytes(b"no journal" * 100)
    assert begun()["marl_mm/reach/two-v0"] is None
    assert noted(locate("none").working) is None
    assert not locate("none").working.exists()


def test_reading_back_is_bit_equal(tmp_path: Path, make_episode: MakeEpisode) -> None:
    with Journal(tmp_path / "x") as journal:
        assert journal.about() is None
        journal.begin({"seed": 3})
        for number in (4, 1):
            journal.add(make_episode(number))
    with Journal(tmp_path / "x") as journal:
        assert journal.about() == {"seed": 3}
        found = journal.episodes(REACH)
        assert sorted(found) == [1, 4]
        for number, episode in found.items():
            expected = make_episode(number)
            assert episode.states.tobytes() == expected.states.tobytes()
            assert episode.start.tobytes() == expected.start.tobytes()
            assert episode.actions.dtype == expected.actions.dtype
            for key, values in expected.info.items():
                np.testing.assert_array_equal(episode.info[key], values)
        journal.begin({"seed": 4})
        assert journal.episodes(REACH) == {}


def test_a_killed_writer_loses_nothing_it_finished(tmp_path: Path) -> None:
    killed = write(tmp_path / "x", "kill")
    assert killed.returncode == -signal.SIGKILL
    finished = [int(line) for line in killed.stdout.split()]
    with Journal(tmp_path / "x") as journal:
        assert sorted(journal.episodes(REACH)) == finished == list(range(7))


@pytest.mark.slow
def test_a_full_disk_is_named_and_costs_nothing_finished(tmp_path: Path) -> None:
    """The operating system refuses to let the file grow, as on a full disk."""
    full = write(tmp_path / "x", "full")
    assert full.returncode == 1
    assert "finished episodes are kept: make room" in full.stderr
    finished = [int(line) for line in full.stdout.split()]
    assert 3 < len(finished) < 100
    with Journal(tmp_path / "x") as journal:
        assert sorted(journal.episodes(REACH)) == finished
        journal.add(journal.episodes(REACH)[0])


def test_a_damaged_journal_is_named(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"no database, but long enough to look like one" * 9)
    with pytest.raises(DatasetError, match="damaged"):
        Journal(tmp_path)


# --- Journals from strangers -------------------------------------------------

MAGIC = bytes.fromhex("d9d505f920a163d7")


def rollback(folder: Path, names: Path | None, pages: int = 3) -> None:
    """A journal beside a database that SQLite would play back when it opens it."""
    with Journal(folder) as journal:
        journal.begin({})
    database = (folder / FILE).read_bytes()
    data = struct.pack(">8sIIIII", MAGIC, 1, 7, pages, 512, 4096).ljust(512, b"\0")
    checksum = 7 + sum(database[place] for place in range(4096 - 200, 0, -200))
    data += struct.pack(">I", 1) + database[:4096] + struct.pack(">I", checksum)
    if names is not None:
        name = str(names).encode()
        data += struct.pack(">I", 2**30 // 4096 + 1) + name
        data += struct.pack(">II", len(name), sum(name)) + MAGIC
    (folder / f"{FILE}-journal").write_bytes(data)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def refused(folder: Path, match: str) -> None:
    """It is neither read nor resumed, and nothing is changed."""
    before = contents(folder)
    with pytest.raises(DatasetError, match=match), reading(folder) as journal:
        journal.about(), len(journal), journal.episodes(REACH)
    with pytest.raises(DatasetError, match=match), Journal(folder) as journal:
        journal.about(), len(journal), journal.episodes(REACH)
    assert noted(folder) is None
    assert contents(folder) == before


def test_no_journal_deletes_a_file_that_it_names(
    datasets_home: Path, tmp_path: Path
) -> None:
    precious = tmp_path / "precious"
    precious.write_text("mine")
    location = locate("evil")
    rollback(location.working, precious)
    assert begun() == {"marl_mm/reach/evil-v0": None}
    refused(location.working, "names another file, which SQLite would delete")
    assert precious.read_text() == "mine"
    discard(location.working)
    assert list(location.working.iterdir()) == []


def test_a_journal_that_was_cut_off_is_read_without_a_change(tmp_path: Path) -> None:
    rollback(tmp_path / "x", None)
    before = contents(tmp_path / "x")
    with reading(tmp_path / "x") as journal:
        assert len(journal) == 0
    assert contents(tmp_path / "x") == before and len(before) == 2
    with Journal(tmp_path / "x") as journal:
        assert len(journal) == 0
    assert len(contents(tmp_path / "x")) == 1


def test_a_journal_undoes_to_no_larger_file(tmp_path: Path) -> None:
    rollback(tmp_path, None, pages=2**31)
    refused(tmp_path, "it undoes to 8,796,093,022,208 bytes")


@pytest.mark.parametrize("name", [FILE, f"{FILE}-journal"])
def test_a_journal_that_is_a_link_leaves_the_other_file_alone(
    tmp_path: Path, name: str
) -> None:
    victim = tmp_path / "victim.db"
    with closing(sqlite3.connect(victim)) as file, file:
        file.execute("create table mine (text)")
    before = victim.read_bytes()
    rollback(tmp_path / "x", None)
    (tmp_path / "x" / name).unlink()
    (tmp_path / "x" / name).symlink_to(victim)
    refused(tmp_path / "x", "is a link to")
    assert victim.read_bytes() == before


@pytest.mark.parametrize(
    "statement",
    [
        "create table other (text)",
        "create view more as select 1",
        "drop table about; create table about "
        "(x, text generated always as (hex(zeroblob(450000000))))",
    ],
)
def test_a_journal_holds_its_two_tables_alone(tmp_path: Path, statement: str) -> None:
    rollback(tmp_path, None)
    (tmp_path / f"{FILE}-journal").unlink()
    with closing(sqlite3.connect(tmp_path / FILE)) as file, file:
        file.executescript(statement)
    refused(tmp_path, "expected the tables about and episodes as they were made")


def test_a_journal_with_a_write_ahead_log_is_refused(tmp_path: Path) -> None:
    with Journal(tmp_path) as journal:
        journal.begin({})
    with closing(sqlite3.connect(tmp_path / FILE)) as file:
        file.execute("pragma journal_mode = wal")
    refused(tmp_path, "write-ahead log")


def test_compressed_episodes_are_refused(
    tmp_path: Path, make_episode: MakeEpisode
) -> None:
    with Journal(tmp_path) as journal:
        journal.begin({})
        journal.add(make_episode(0))
    blob = io.BytesIO()
    arrays = arrays_of([make_episode(0)], "")
    zeros = {"zeros": np.zeros((len(arrays.rewards), 10_000))}
    save_arrays(blob, replace(arrays, info=arrays.info | zeros), compress=True)
    with closing(sqlite3.connect(tmp_path / FILE)) as file, file:
        file.execute("update episodes set npz = ?", [blob.getvalue()])
    with reading(tmp_path) as journal, pytest.raises(DatasetError, match="is damaged"):
        journal.episodes(REACH)


def test_rows_that_repeat_are_refused(tmp_path: Path) -> None:
    """In a tree whose pages stand in several places they would never end."""
    with Journal(tmp_path) as journal:
        journal.begin({})
    with closing(sqlite3.connect(tmp_path / FILE)) as file, file:
        values = [(number, bytes(10)) for number in range(3)]
        file.executemany("insert into episodes values (?, ?)", values)
    data = bytearray((tmp_path / FILE).read_bytes())
    pointers = 2 * 4096 + 8  # of the third page's three rows, 2 bytes each
    data[pointers : pointers + 6] = 3 * data[pointers : pointers + 2]
    (tmp_path / FILE).write_bytes(data)
    with reading(tmp_path) as journal, pytest.raises(DatasetError, match="repeat"):
        len(journal)


def test_a_value_that_claims_more_bytes_than_the_file_has_is_refused(
    tmp_path: Path,
) -> None:
    """Its pages lead in a circle, and would be read again and again."""

    def varint(number: int) -> bytes:
        parts = [number >> 14, number >> 7 & 127, number & 127]
        return bytes([parts[0] | 128, parts[1] | 128, parts[2]])

    with Journal(tmp_path) as journal:
        journal.begin({})
    with closing(sqlite3.connect(tmp_path / FILE)) as file, file:
        file.execute("insert into episodes values (0, ?)", [bytes(999_000)])
    data = (tmp_path / FILE).read_bytes()
    more = 12 * 4092  # a page's bytes, without the number of the next
    for number, factor in ((999_005, 1), (2 * 999_000 + 12, 2)):  # record, its value
        assert data.count(varint(number)) == 1
        data = data.replace(varint(number), varint(number + factor * more))
    (tmp_path / FILE).write_bytes(data)
    with reading(tmp_path) as journal, pytest.raises(DatasetError, match="too big"):
        journal.episodes(REACH)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ("update about set text = replace(text, '3', '4')", "not as it was written"),
        ("update episodes set number = 5", "an episode in .* is damaged"),
    ],
)
def test_a_journal_that_was_changed_is_not_gone_on_with(
    tmp_path: Path, make_episode: MakeEpisode, change: str, match: str
) -> None:
    """Its record has a checksum, and an episode knows its number."""
    with Journal(tmp_path) as journal:
        journal.begin({"seed": 3})
        journal.add(make_episode(4))
    with closing(sqlite3.connect(tmp_path / FILE)) as file, file:
        file.execute(change)
    for opened in (reading, Journal):
        with pytest.raises(DatasetError, match=match), opened(tmp_path) as journal:
            journal.about(), journal.episodes(REACH)
