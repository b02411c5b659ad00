"""Files appear whole or not at all, whoever is killed and whatever fails."""

import json
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from marl_mm.errors import OutputExistsError, UsageError
from marl_mm.files import new_file, new_folder, only_here, refuse_existing, write_json


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
    path = tmp_path / "folder"
    for content in ("first", "second"):
        with new_folder(path) as temporary:
            (temporary / content).write_text(content)
        assert names(path) == [content] and names(tmp_path) == ["folder"]


KILLED = """
    import os, signal, sys
    from pathlib import Path
    from marl_mm.files import {writer}
    with {writer}(Path(sys.argv[1])) as temporary:
        where = temporary / "part" if temporary.is_dir() else temporary
        where.write_text("half")
        os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize(
    ("writer", "again"), [("new_file", new_file), ("new_folder", new_folder)]
)
def test_a_killed_writer_is_as_if_it_had_not_begun(
    tmp_path: Path, writer: str, again: Callable[..., object]
) -> None:
    """What it leaves beside goes with the next writer of that name."""
    path = tmp_path / "out"
    process = in_a_process(KILLED.format(writer=writer), path)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert not path.exists()
    with again(path) as temporary:  # type: ignore[attr-defined]
        (temporary / "part" if temporary.is_dir() else temporary).write_text("whole")
    assert names(tmp_path) == ["out"]
    found = path / "part" if path.is_dir() else path
    assert found.read_text() == "whole"


HOLDER = """
    import sys, time
    from pathlib import Path
    from marl_mm.files import only_here
    with only_here(Path(sys.argv[1])):
        print("inside", flush=True)
        time.sleep(60)
"""


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
        (folder / "left").write_text("by the first")
    told, _ = process.communicate(timeout=60)
    assert told == "by the first\n"


def test_outputs_that_exist_or_cannot_be_are_refused_before_work(
    tmp_path: Path,
) -> None:
    there = tmp_path / "there"
    there.write_text("")
    with pytest.raises(OutputExistsError, match="--overwrite"):
        refuse_existing(there, overwrite=False)
    refuse_existing(there, overwrite=True)
    refuse_existing(tmp_path / "not" / "yet", overwrite=False)
    with pytest.raises(UsageError, match="is no folder open to you"):
        refuse_existing(there / "below-a-file", overwrite=True)


def test_json_is_whole_or_as_before(tmp_path: Path) -> None:
    path = tmp_path / "values.json"
    write_json(path, {"a": [1, 2]})
    with pytest.raises(TypeError):
        write_json(path, {"a": object()})
    assert json.loads(path.read_text()) == {"a": [1, 2]}
    assert names(tmp_path) == ["values.json"] and os.access(path, os.R_OK)
