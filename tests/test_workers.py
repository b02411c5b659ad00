"""Maps over processes: order, completion, and processes that crash or hang.

Functions are those that any process can import by name.
"""

import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from marl_mm.errors import WorkerDiedError
from marl_mm.workers import Workers, apart


def test_apart_gives_results_and_errors() -> None:
    assert apart(abs, -4, seconds=60) == 4
    with pytest.raises(ValueError, match="invalid literal"):
        apart(int, "four", seconds=60)


def test_apart_survives_a_crash_and_ends_what_hangs() -> None:
    with pytest.raises(WorkerDiedError, match="crashed"):
        apart(os._exit, 3, seconds=60)
    with pytest.raises(WorkerDiedError, match="no end after 1 s"):
        apart(time.sleep, 600, seconds=1)


def test_workers_live_in_the_environment_of_when_they_are_begun(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for value in ("first", "second"):
        monkeypatch.setenv("MARL_MM_TEST", value)
        with Workers(2) as pool:
            assert list(pool.map(os.getenv, ["MARL_MM_TEST"] * 4)) == [value] * 4


def test_workers_are_of_the_package_that_began_them(tmp_path: Path) -> None:
    """Not of one that has its name, and lies where the command is run."""
    (tmp_path / "marl_mm").mkdir()
    (tmp_path / "marl_mm/__init__.py").write_text("raise SystemExit('not this one')")
    script = tmp_path / "bin/command.py"
    script.parent.mkdir()
    script.write_text(
        "from marl_mm.workers import Workers\n"
        "if __name__ == '__main__':\n"
        "    with Workers(2) as pool: print(*pool.map(abs, [-1, -2]))\n"
    )
    command = [sys.executable, str(script)]
    assert subprocess.check_output(command, cwd=tmp_path, timeout=60) == b"1 2\n"


@pytest.mark.slow
def test_results_come_in_order_or_as_they_are_ready() -> None:
    function = partial(pow, 2)
    with Workers(2) as pool:
        assert list(pool.map(function, range(9))) == [2**i for i in range(9)]
        assert sorted(pool.completed(function, range(9))) == [2**i for i in range(9)]
        with pytest.raises(ZeroDivisionError):
            list(pool.completed(partial(divmod, 1), [1, 0]))
        with pytest.raises(WorkerDiedError, match="fewer --workers"):
            list(pool.completed(os._exit, [1]))
