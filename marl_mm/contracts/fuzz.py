"""Trial by hostile files: what becomes of many mutations of a good file or folder."""

import hashlib
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from marl_mm.contracts.claims import Claim, demand
from marl_mm.contracts.files import fingerprint
from marl_mm.contracts.mutations import mutate
from marl_mm.errors import MarlMmError, WorkerDiedError
from marl_mm.workers import apart

PATIENCE = 10.0
"""Longest time that reading a mutation may take [s]."""


@dataclass(frozen=True)
class Trial:
    """What became of a mutation."""

    number: int
    """Number of the mutation; with the seed, it is made again."""

    mutation: str
    """Description of the mutation."""

    outcome: str
    """``refused``, ``accepted``, or what must not be: a traceback, a hang, a crash, a
    changed file, or damage that was accepted."""

    message: str = ""
    """Message of the error, if there was one."""

    @property
    def broken(self) -> bool:
        """Whether the outcome must not be."""
        return self.outcome not in ("refused", "accepted")


def trials(path: Path, count: int, seed: int, begin: int = 0) -> Iterator[Trial]:
    """Mutate copies of a good file or folder, and read each in a process of its own.

    Args:
        path: File or folder of a kind that ``kind_of`` knows.
        count: Number of mutations.
        seed: Seed of the mutations.
        begin: Number of the first mutation.

    Raises:
        MarlMmError: If the file itself is damaged.
    """
    good = fingerprint(path)
    for number in range(begin, begin + count):
        with TemporaryDirectory(prefix="marl_mm-") as folder:
            yield _trial(path, Path(folder), number, seed, good)


def file_claims(mutations: int, seed: int) -> dict[str, Claim]:
    """Claims about a file or folder.

    Args:
        mutations: Number of mutations; 0: no claim about them.
        seed: Seed of the mutations.
    """

    def hostile(path: Path) -> None:
        broken = [trial for trial in trials(path, mutations, seed) if trial.broken]
        shown = "; ".join(f"{t.number}, {t.mutation}: {t.outcome}" for t in broken[:3])
        demand(not broken, f"{len(broken)} of {mutations} mutations: {shown}")

    claims: dict[str, Claim] = {"it is whole, plausible and of known form": fingerprint}
    if mutations:
        claims[f"{mutations} mutations are refused, or harmless"] = hostile
    return claims


def _trial(path: Path, folder: Path, number: int, seed: int, good: str) -> Trial:
    copy = folder / path.name
    (shutil.copytree if path.is_dir() else shutil.copy)(path, copy)
    mutation = mutate(copy, np.random.default_rng([seed, number]))
    before, message = _bytes_of(folder), ""
    try:
        outcome, message = apart(_read, copy, PATIENCE)
    except WorkerDiedError as error:
        outcome, message = "crash or hang", str(error)
    if outcome == "accepted" and not mutation.plausible and message != good:
        outcome = "damage accepted"
    if _bytes_of(folder) != before:
        outcome = "changed file"
    return Trial(number, mutation.about, outcome, "" if message == good else message)


def _read(path: Path) -> tuple[str, str]:
    """Outcome of reading a file, and the error's message or the contents' hash."""
    try:
        return "accepted", fingerprint(path)
    except MarlMmError as error:
        several = "\n" in str(error)
        return "error of several lines" if several else "refused", str(error)
    except Exception as error:
        return "traceback", f"{type(error).__name__}: {error}"


def _bytes_of(folder: Path) -> dict[str, str]:
    """What is in a folder: hashes of files, and what else there is, by name."""
    contents = {}
    for path in sorted(folder.rglob("*")):
        kind = "other"
        if path.is_symlink():
            kind = f"link to {os.readlink(path)}"
        elif path.is_file():
            kind = hashlib.sha256(path.read_bytes()).hexdigest()
        contents[str(path.relative_to(folder))] = kind
    return contents
