"""d3rlpy's algorithms in a process of another Python, as learners to be timed."""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

import numpy as np

from marl_mm.algorithms.replay import normalized_actions
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.errors import UsageError
from marl_mm.eval.bench import d3rlpy_reference

Rate = Callable[[int, int], float]
"""Updates per second of a number of updates, with a number of threads."""


def named(name: str) -> str:
    """Label of d3rlpy's form of an algorithm."""
    return f"{name}, d3rlpy's"


@contextmanager
def learners_of(python: Path) -> Iterator[dict[str, Rate]]:
    """d3rlpy's learners, in a process of its Python."""
    with (
        TemporaryDirectory() as folder,
        TemporaryFile("w+", encoding="utf-8") as errors,
    ):
        file = Path(folder) / "data.npz"
        _export(file)
        command = [str(python), d3rlpy_reference.__file__, str(file)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": errors}
        try:
            job = subprocess.Popen(command, text=True, cwd=folder, **pipes)  # type: ignore[call-overload]
        except OSError as error:
            raise UsageError(f"{python} does not run: {error.strerror}") from None

        def answer() -> str:
            if line := job.stdout.readline():
                return str(line)
            errors.seek(0)
            *_, complaint = errors.read().splitlines() or ["it ended without a word"]
            raise UsageError(f"{python} has no d3rlpy that works: {complaint}")

        def rate(name: str) -> Rate:
            def ask(updates: int, threads: int) -> float:
                job.stdin.write(f"{name} {threads} {updates}\n")
                job.stdin.flush()
                return float(answer())

            return ask

        with job:
            answer()
            yield {named(name): rate(name) for name in d3rlpy_reference.NAMES}
            job.stdin.close()


def _export(path: Path) -> None:
    """The dataset that ships, as a file of transitions."""
    arrays = shipped_arrays()
    np.savez(
        path,
        observation=arrays.states[~arrays.is_last_state()].astype(np.float32),
        next_observation=arrays.states[~arrays.is_first_state()].astype(np.float32),
        action=normalized_actions(arrays.actions, arrays.layout).astype(np.float32),
        reward=arrays.rewards.astype(np.float32),
        terminated=arrays.terminated,
        ended=arrays.terminated | arrays.truncated,
    )
