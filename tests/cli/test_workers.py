"""Maps over processes: order, completion, and processes that crash or hang.

Functions are those that any process can import by name.
"""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from marl_mm.cli import main
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.errors import MarlMmError, UsageError, WorkerDiedError
from marl_mm.eval.evaluate import evaluate
from marl_mm.workers import Workers, apart, available_cores, check_workers


def test_cores_are_those_it_may_use_or_as_many_as_it_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("PYTHON_CPU_COUNT", raising=False)
    assert available_cores() == len(os.sched_getaffinity(0))
    monkeypatch.setenv("PYTHON_CPU_COUNT", "7")
    assert available_cores() == 7
    monkeypatch.setenv("PYTHON_CPU_COUNT", "many")
    assert main(["eval", "random"]) == 2
    text = capsys.readouterr().err
    assert text == "marl-mm: PYTHON_CPU_COUNT is 'many', expected a number of cores\n"


def test_apart_gives_results_and_errors() -> None:
    assert apart(abs, -4, seconds=60) == 4
    with pytest.raises(ValueError, match="invalid literal"):
        apart(int, "four", seconds=60)


def test_apart_survives_a_crash_and_ends_what_hangs() -> None:
    with pytest.raises(WorkerDiedError, match="crashed"):
        apart(os._exit, 3, seconds=60)
    with pytest.raises(WorkerDiedError, match="no end after 1 s"):
        apart(time.sleep, 600, seconds=1)
    with pytest.raises(WorkerDiedError, match="more memory than it may have"):
        apart(bytearray, 10**9, seconds=60, memory=10**8)


def test_workers_live_in_the_environment_of_when_they_are_begun(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for value in ("first", "second"):
        monkeypatch.setenv("MARL_MM_TEST", value)
        with Workers(2) as pool:
            assert list(pool.map(os.getenv, ["MARL_MM_TEST"] * 4)) == [value] * 4


def test_an_error_that_cannot_leave_its_process_is_told_in_words() -> None:
    raising = "import urllib.error; raise urllib.error.ContentTooShortError('half', 0)"
    with Workers(2) as pool:
        with pytest.raises(MarlMmError, match=r"ContentTooShortError: .*half"):
            list(pool.map(exec, [raising]))
        assert list(pool.map(abs, [-1])) == [1]
    with pytest.raises(MarlMmError, match=r"ContentTooShortError: .*half"):
        apart(exec, raising, seconds=60)


def test_workers_are_of_the_package_that_began_them(tmp_path: Path) -> None:
    """Not of one that has its name, and lies where the command is run."""
    (tmp_path / "marl_mm").mkdir()
    (tmp_path / "marl_mm/__init__.py").write_text("raise SystemExit('not this one')")
    body = "with Workers(2) as pool: print(*pool.map(abs, [-1, -2]))"
    assert run_script(tmp_path, body).stdout == "1 2\n"


def test_workers_never_hear_interrupts(tmp_path: Path) -> None:
    """Those of the terminal are for the command, which ends them."""
    body = (
        "blocked = partial(signal.pthread_sigmask, signal.SIG_BLOCK)\n"
        "    with Workers(2) as pool:\n"
        "        print(*map(list, pool.map(blocked, [(), ()])))"
    )
    output = run_script(tmp_path, body).stdout
    assert output == f"{[signal.SIGINT]} {[signal.SIGINT]}\n"


def test_what_else_is_forked_from_the_server_begins_as_if_it_were_not_ours(
    tmp_path: Path,
) -> None:
    body = (
        "os.environ['OWN'] = '1'\n"
        "    with Workers(2) as pool: list(pool.map(abs, [1]))\n"
        "    with get_context('forkserver').Pool(1) as pool:\n"
        "        print(*pool.map(os.getenv, ['PYTHONSAFEPATH', 'PYTHONPATH', 'OWN']))"
    )
    assert run_script(tmp_path, body).stdout == "None None 1\n"


@pytest.mark.slow
def test_a_server_that_is_killed_while_it_imports_is_told(tmp_path: Path) -> None:
    body = (
        "from marl_mm.runs.seeds import _begin_process\n"
        "    pool = Workers(2, _begin_process)\n"
        "    server = forkserver._forkserver._forkserver_pid\n"
        "    threading.Timer(0.3, os.kill, (server, signal.SIGKILL)).start()\n"
        "    list(pool.map(abs, [1]))"
    )
    assert "WorkerDiedError: the process that starts the workers died" in (
        run_script(tmp_path, body).stderr
    )


PLAIN = """
import logging
from marl_mm.errors import UsageError
from marl_mm.workers import Workers
print("begun", type(1).__name__, logging.getLogger(__name__).name)
class Own:
    def __init__(self, *numbers):
        pass
    def __call__(self, number):
        return number
with Workers(2, threads=True) as pool:
    print(*pool.map(Own(), [-1, -2]))
with Workers(2) as pool:
    print(*pool.map(abs, [-1, -2]))
    for function, item in ((Own, 1), (id, Own()), (id, [Own()])):
        try:
            list(pool.map(function, [item]))
        except UsageError as error:
            print(error)
try:
    Workers(2, id, ([Own()],))
except UsageError as error:
    print(error)
print(__name__)
"""


@pytest.mark.slow
@pytest.mark.parametrize("command", [("plain.py",), ("-m", "plain"), ("plain",), None])
def test_a_script_without_a_guard_has_workers_and_runs_once(
    tmp_path: Path, command: tuple[str, ...] | None
) -> None:
    """None: a notebook, whose classes are of no file either."""
    for name in ("plain.py", "plain"):
        (tmp_path / name).write_text(PLAIN)
    ran = subprocess.run(
        [sys.executable, *(command or ("-c", PLAIN))],
        cwd=tmp_path,
        timeout=60,
        capture_output=True,
        text=True,
    )
    begun, threads, results, *errors, end = ran.stdout.splitlines()
    assert (begun, end) == ("begun int __main__", "__main__"), ran.stderr
    assert (threads, results) == ("-1 -2", "1 2")
    assert len(errors) == 4
    assert all('under `if __name__ == "__main__":`' in error for error in errors)
    assert not ran.stderr


def run_script(folder: Path, body: str) -> "subprocess.CompletedProcess[str]":
    """Run it as somebody's own script, in a folder that is not the project's."""
    script = folder / "scripts/own.py"
    script.parent.mkdir()
    script.write_text(
        "import os, signal, threading\n"
        "from functools import partial\n"
        "from multiprocessing import forkserver, get_context\n"
        "from marl_mm.workers import Workers\n"
        f"if __name__ == '__main__':\n    {body}\n"
    )
    own = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    command = [sys.executable, str(script)]
    return subprocess.run(
        command, cwd=folder, env=own, timeout=60, capture_output=True, text=True
    )


@pytest.mark.slow
def test_results_come_in_order_or_as_they_are_ready() -> None:
    function = partial(pow, 2)
    with Workers(2) as pool:
        assert list(pool.map(function, range(9))) == [2**i for i in range(9)]
        assert sorted(pool.completed(function, range(9))) == [2**i for i in range(9)]
        with pytest.raises(ZeroDivisionError):
            list(pool.completed(partial(divmod, 1), [1, 0]))
        with pytest.raises(WorkerDiedError, match="fewer `workers`"):
            list(pool.completed(os._exit, [1]))


class Unsendable:
    """It takes a while to see that it cannot go to another process."""

    def __reduce__(self) -> str:
        time.sleep(0.1)
        raise TypeError("stays here")


def test_a_pool_ends_when_its_items_cannot_be_sent() -> None:
    """Closing it while later items are looked at would wait for them forever."""
    with Workers(2) as pool, pytest.raises(UsageError, match="stays here"):
        list(pool.map(id, [Unsendable() for _ in range(8)]))


@pytest.mark.parametrize("workers", [0, -1])
def test_no_processes_are_too_few(workers: int) -> None:
    with pytest.raises(UsageError, match=f"workers is {workers}, expected 1 to"):
        check_workers(workers)
    with pytest.raises(UsageError, match=f"workers is {workers}, expected 1 to"):
        evaluate(RandomPolicy(RandomConfig()), 1, workers=workers)


def test_processes_are_at_most_four_a_core_or_64(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for cores, most in (("1", 64), ("16", 64), ("100", 400)):
        monkeypatch.setenv("PYTHON_CPU_COUNT", cores)
        check_workers(most)
        with pytest.raises(UsageError, match=f"expected 1 to {most}"):
            check_workers(most + 1)
    monkeypatch.setenv("PYTHON_CPU_COUNT", "0")
    with pytest.raises(UsageError, match="PYTHON_CPU_COUNT is '0'"):
        available_cores()
