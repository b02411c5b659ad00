"""Files appear whole or not at all, whoever is killed and whatever fails."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from marl_mm.errors import OutputExistsError, UsageError
from marl_mm.files import (
    append,
    is_there,
    new_file,
    new_folder,
    only_here,
    refuse_existing,
    write_bytes,
    write_json,
)


def in_a_process(code: str, *arguments: object) -> "subprocess.Popen[str]":
    words = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_appears_when_its_writer_is_done(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "file.txt"
    with new_file(path) as temporary:
        temporary.write_text("whole")
        assert not path.exists() and temporary.parent == path.parent
    assert path.read_text() == "whole" and names(path.parent) == ["file.txt"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_writer_that_fails_leaves_the_old_file(
    tmp_path: Path, error: type[BaseException]
) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(error), new_file(path) as temporary:
        temporary.write_text("half")
        raise error
    assert path.read_text() == "old" and names(tmp_path) == ["file.txt"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_writer_that_fails_leaves_the_old_folder(
    tmp_path: Path, error: type[BaseException]
) -> None:
    path = tmp_path / "folder"
    path.mkdir()
    (path / "old").write_text("old")
    with pytest.raises(error), new_folder(path) as temporary:
        (temporary / "half").write_text("half")
        raise error
    assert names(path) == ["old"] and names(tmp_path) == ["folder"]


def test_a_folder_takes_the_others_place_with_all_that_is_in_it(tmp_path: Path) -> None:
    path, link = tmp_path / "folder", tmp_path / "link"
    link.symlink_to("folder")
    for content, place in (("first", path), ("second", path), ("third", link)):
        with new_folder(place) as temporary:
            (temporary / content).write_text(content)
        assert names(path) == [content] and names(tmp_path) == ["folder", "link"]
    assert link.is_symlink()


@pytest.mark.parametrize("writer", [new_file, new_folder])
def test_what_does_not_reach_the_disk_replaces_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: Callable[..., Any]
) -> None:
    """It is forced there before its name is given away."""
    path, part = tmp_path / "out", Path("part" if writer is new_folder else "")
    with writer(path) as temporary:
        (temporary / part).write_text("old")

    def full(descriptor: int) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="no space"), writer(path) as temporary:
        (temporary / part).write_text("new")
    assert (path / part).read_text() == "old" and names(tmp_path) == ["out"]


def test_who_reads_the_old_file_reads_it_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "values.json"
    write_json(path, "old")
    with path.open() as reading:
        write_json(path, "new")
        assert json.load(reading) == "old" and json.loads(path.read_text()) == "new"


def test_an_old_folder_goes_when_the_new_one_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At no time is there none."""
    path, found, remove = tmp_path / "folder", [], shutil.rmtree

    def watched(folder: Path, **options: Any) -> None:
        remove(folder, **options)
        found.append(names(path))

    monkeypatch.setattr(shutil, "rmtree", watched)
    for content in ("first", "second"):
        with new_folder(path) as temporary:
            (temporary / content).write_text(content)
    assert found == [["second"]]


KILLED = """
    import os, signal, sys
    from pathlib import Path
    from marl_mm.files import {writer}
    with {writer}(Path(sys.argv[1])) as temporary:
        where = temporary / "part" if temporary.is_dir() else temporary
        where.write_text("half")
        os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize("writer", [new_file, new_folder])
def test_a_killed_writer_is_as_if_it_had_not_begun(
    tmp_path: Path, writer: Callable[..., Any], before: bool
) -> None:
    """What it leaves beside goes with the next writer of that name."""
    path, part = tmp_path / "out", Path("part" if writer is new_folder else "")
    if before:
        with writer(path) as temporary:
            (temporary / part).write_text("old")
    process = in_a_process(KILLED.format(writer=writer.__name__), path)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert path.exists() == before and len(names(tmp_path)) == 1 + before
    assert not before or (path / part).read_text() == "old"
    with writer(path) as temporary:
        (temporary / part).write_text("whole")
    assert names(tmp_path) == ["out"] and (path / part).read_text() == "whole"


def test_what_others_are_at_or_own_stays(tmp_path: Path) -> None:
    """Of writers that are dead only, of other machines once they are a day old."""
    with new_file(tmp_path / "table.csv") as theirs:
        theirs.write_text("theirs")
        machine = theirs.name.split(".")[2][:8]
        dead, elsewhere = f"{machine}{0:08x}", f"{0:016x}"
        kept = [".table.2024.csv", f".table.{elsewhere}.part.csv", f".other.{dead}.new"]
        late = f".table.{1:016x}.part.csv"
        for name in (*kept, late, f".table.{dead}.part.csv"):
            (tmp_path / name).write_text("half")
        os.utime(tmp_path / late, (0, 0))
        with new_file(tmp_path / "table.csv") as ours:
            ours.write_text("ours")
        assert names(tmp_path) == sorted([*kept, theirs.name, "table.csv"])
        assert (tmp_path / "table.csv").read_text() == "ours"
    assert (tmp_path / "table.csv").read_text() == "theirs"


@pytest.mark.parametrize("writer", [new_file, new_folder])
def test_threads_that_write_the_same_do_not_mix(
    tmp_path: Path, writer: Callable[..., Any]
) -> None:
    path, part = tmp_path / "out", Path("part" if writer is new_folder else "")

    def write(letter: str) -> None:
        for _ in range(20):
            with writer(path) as temporary:
                for end in (1, 100):
                    (temporary / part).write_text(letter * end)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, "abcd"))
    assert names(tmp_path) == ["out"]
    assert (path / part).read_text() in [letter * 100 for letter in "abcd"]


HOLDER = """
    import sys, time
    from pathlib import Path
    from marl_mm.files import only_here
    with only_here(Path(sys.argv[1])):
        print("inside", flush=True)
        time.sleep(60)
"""


def test_what_is_appended_is_safe_from_a_power_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes, path = [], tmp_path / "rows"
    monkeypatch.setattr(os, "fsync", lambda file: sizes.append(os.fstat(file).st_size))
    append(path, b"one\n")
    append(path, b"two\n")
    assert sizes == [4, 8]


def test_what_cannot_be_told_is_not_taken_for_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a file server that does not answer: on Python 3.14 ``exists`` says no."""
    assert is_there(tmp_path) and not is_there(tmp_path / "no" / "way")
    (tmp_path / "file").touch()
    assert not is_there(tmp_path / "file" / "below")

    def silent(path: Path, **options: Any) -> os.stat_result:
        raise OSError(errno.EIO, "no answer")

    monkeypatch.setattr(Path, "stat", silent)
    with pytest.raises(OSError, match="no answer"):
        is_there(tmp_path)


def test_one_process_at_a_time_is_in_a_folder(tmp_path: Path) -> None:
    """Until it ends, even by a kill."""
    folder = tmp_path / "folder"
    holder = in_a_process(HOLDER, folder)
    assert holder.stdout is not None and holder.stdout.readline() == "inside\n"
    with pytest.raises(UsageError, match=str(folder)), only_here(folder):
        pass
    holder.kill()
    holder.communicate()
    with only_here(folder):
        assert folder.is_dir()
    with pytest.raises(BlockingIOError, match="no more processes"), only_here(folder):
        raise BlockingIOError("no more processes")  # which is none of the lock


def test_who_waits_comes_in_when_the_other_leaves(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    waiting = """
        import sys
        from pathlib import Path
        from marl_mm.files import only_here
        print("before", flush=True)
        with only_here(Path(sys.argv[1]), wait=True):
            print((Path(sys.argv[1]) / "left").read_text(), flush=True)
    """
    with only_here(folder):
        process = in_a_process(waiting, folder)
        assert process.stdout is not None and process.stdout.readline() == "before\n"
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.5)
        (folder / "left").write_text("by the first")
    output, _ = process.communicate(timeout=60)
    assert output == "by the first\n"


def test_outputs_that_exist_or_cannot_be_are_refused_before_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = tmp_path / "there"
    there.write_text("")
    with pytest.raises(OutputExistsError, match="`overwrite=True`"):
        refuse_existing(there, overwrite=False)
    refuse_existing(there, overwrite=True)
    refuse_existing(tmp_path / "not" / "yet", overwrite=False)
    with pytest.raises(UsageError, match="is no folder open to you"):
        refuse_existing(there / "below-a-file", overwrite=True)
    for name in (
        "joined\u200c",
        "joined\u200d",
        "\u200fturned",
        "\u540d\u524d",
        "\xe9",
    ):
        refuse_existing(tmp_path / name, overwrite=False)
    for name in ("s\udce9", "lo\u200bg", "a\u202eb"):
        with pytest.raises(UsageError, match="the path has a control character"):
            refuse_existing(tmp_path / name, overwrite=True)
    for path in (Path("~"), Path("~/runs/0")):
        with pytest.raises(UsageError, match="only shells know ~"):
            refuse_existing(path, overwrite=True)
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK)
    with pytest.raises(UsageError, match=f"{tmp_path} is no folder open to you"):
        refuse_existing(tmp_path / "not" / "yet", overwrite=True)


def test_devices_are_not_replaced_and_links_stay(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="neither a file nor a folder"):
        refuse_existing(Path("/dev/null"), overwrite=True)
    link, far = tmp_path / "link", tmp_path / "far"
    far.mkdir()
    link.symlink_to(far / "file")
    for text in ("first", "second"):
        write_bytes(link, text.encode())
        assert link.is_symlink() and (far / "file").read_text() == text
    assert names(far) == ["file"]


def test_links_that_lead_nowhere_are_named(tmp_path: Path) -> None:
    lost, circle = tmp_path / "lost", tmp_path / "circle"
    lost.symlink_to("/nowhere/at/all")
    circle.symlink_to(circle)
    for folder in (lost, lost / "0"):
        with pytest.raises(UsageError, match="link to /nowhere/at/all, which is not"):
            refuse_existing(folder, overwrite=True)
        with pytest.raises(UsageError, match="which is not"), only_here(folder):
            pass
    for path in (circle, circle / "file"):
        with pytest.raises(UsageError, match=f"cannot write {path}"):
            refuse_existing(path, overwrite=True, file=True)


def test_json_is_whole_or_as_before(tmp_path: Path) -> None:
    path = tmp_path / "values.json"
    write_json(path, {"a": [1, 2]})
    with pytest.raises(TypeError):
        write_json(path, {"a": object()})
    assert json.loads(path.read_text()) == {"a": [1, 2]}
    assert names(tmp_path) == ["values.json"] and os.access(path, os.R_OK)


def test_a_folder_is_on_the_disk_with_all_that_is_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its files and folders before it has its name, and that name at last."""
    forced: list[str] = []
    monkeypatch.setattr(
        os, "fsync", lambda file: forced.append(os.readlink(f"/proc/self/fd/{file}"))
    )
    with new_folder(tmp_path / "out") as temporary:
        (temporary / "in").mkdir()
        (temporary / "in" / "part").write_text("whole")
    *parts, last = forced
    expected = [temporary, temporary / "in", temporary / "in" / "part"]
    assert sorted(parts) == sorted(map(str, expected)) and last == str(tmp_path)


def test_who_waited_for_a_folder_that_is_gone_locks_the_new_one(tmp_path: Path) -> None:
    """A folder of the same name that nobody else may be in."""
    folder = tmp_path / "folder"

    def others_are_kept_out() -> bool:
        with only_here(folder, wait=True):
            with pytest.raises(UsageError, match="another process"), only_here(folder):
                pass
            return folder.is_dir()

    with ThreadPoolExecutor(1) as pool:
        with only_here(folder):
            waiting = pool.submit(others_are_kept_out)
            with pytest.raises(TimeoutError):
                waiting.result(0.3)
            folder.rmdir()
        assert waiting.result(10)
