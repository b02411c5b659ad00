"""Commands in processes of their own that need not import everything first."""

import os
import signal
import sys
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from marl_mm.processes import process_context

COMMAND = "import sys\nfrom marl_mm.cli import main\nsys.exit(main(sys.argv[1:]))"
"""What ``marl-mm`` runs."""


class Fork:
    """A fork of the server of workers; use it in a ``with`` block, which ends it.

    Args:
        words: Arguments of the command.
        code: What it runs, with ``sys.argv`` of these.
    """

    def __init__(self, *words: object, code: str = COMMAND) -> None:
        self._folder = TemporaryDirectory()
        self._complaint = Path(self._folder.name, "stderr")
        arguments = ["marl-mm", *map(str, words)]
        self._process: Any = get_context("forkserver").Process(
            target=_run,
            args=(dict(os.environ), os.getcwd(), self._complaint, arguments, code),
        )

    def __enter__(self) -> "Fork":
        process_context("marl_mm.runs.train")  # what the server imports
        self._process.start()
        self.pid = int(self._process.pid)
        return self

    def __exit__(self, *exception: object) -> None:
        self.kill()
        self.wait()
        self._folder.cleanup()

    @property
    def complaint(self) -> str:
        """What it has written to stderr."""
        return self._complaint.read_text()

    def running(self) -> bool:
        """Whether it has not ended."""
        return bool(self._process.is_alive())

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def wait(self, seconds: float = 120) -> int:
        """Exit status, or less than 0 by a signal; it is killed after some time."""
        self._process.join(seconds)
        if self.running():
            self.kill()
            self._process.join()
        return int(self._process.exitcode)


def _run(
    environment: dict[str, str],
    folder: str,
    complaint: Path,
    words: list[str],
    code: str,
) -> None:
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    os.setsid()
    for number, path in ((1, os.devnull), (2, complaint)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT, 0o644), number)
    signal.pthread_sigmask(signal.SIG_SETMASK, [])  # the server hears no interrupts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = words
    exec(code, {})
