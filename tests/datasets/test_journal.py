"""The journal keeps every finished episode, whatever happens to its writer."""

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from marl_mm.datasets.journal import FILE, Journal, begun, noted
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
