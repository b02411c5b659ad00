"""The datasets that ablations learn from: what is missing is collected first."""

import shlex
import sys
from contextlib import redirect_stdout
from pathlib import Path

from marl_mm.commands import collect
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import SHIPPED, locate
from marl_mm.errors import UnknownDatasetError
from marl_mm.eval.ablations import BLOCKS, OTHER_TASKS, made_by
from marl_mm.files import only_here

_FEW = 30
"""Steps of what stands for a large dataset."""


def small_dataset(name: str, folder: Path, make: bool) -> Dataset:
    """What stands for a dataset where little is to be trained: a few steps of its task.

    For one of ``Reach-v0`` it is the one that ships.

    Args:
        name: As in a cell.
        folder: Where those of other tasks are.
        make: Whether what is missing is; without, the one that ships stands for it.
    """
    if name not in (*OTHER_TASKS, *BLOCKS):
        return load_dataset(SHIPPED)
    path = (folder / name.replace("/", "-")).resolve()
    if not make and not path.exists():
        return load_dataset(SHIPPED)
    # So few episodes are over before other processes have begun.
    words = [*shlex.split(made_by(name))[2:], "--workers", "1"]
    words += ["--steps", str(_FEW), "--dataset", str(path)]  # the last ones count
    with only_here(path.parent, wait=True):
        if not (
            path.exists() and load_dataset(str(path)).metadata["marl_mm"]["complete"]
        ):
            _collect(words, str(path))
    return load_dataset(str(path))


def dataset_named(name: str, workers: int, make: bool) -> Dataset:
    """A dataset; one of ours that is not there, or not whole, is collected first.

    Args:
        name: As in a cell.
        workers: Processes that collect.
        make: Whether it is.

    Raises:
        UnknownDatasetError: If there is none, saying what would make it.
        KeyboardInterrupt: After Ctrl-C; the same command goes on.
    """
    command = made_by(name)
    words = shlex.split(command)[2:]
    try:
        dataset = load_dataset(name)
    except UnknownDatasetError as error:
        if not command:
            raise
        told = f"no dataset {name}: it is collected first, with {command}"
        if not make:
            raise UnknownDatasetError(told) from error
        print(told, file=sys.stderr)
    else:
        metadata = dataset.metadata["marl_mm"]
        whole = metadata.get("complete", True)
        if "--steps" in words:  # an id may be a collector's usual one
            steps = int(words[words.index("--steps") + 1])
            whole &= metadata.get("steps_asked") == steps
        if whole or not (command and make):
            return dataset
        print(f"{name} is not whole: going on with {command}", file=sys.stderr)
    _collect([*words, "--workers", str(workers)], name)
    return load_dataset(name)


def _collect(words: list[str], name: str) -> None:
    """Begin a collection, or go on with it."""
    location = locate(name)
    if location.folder.exists() or location.working.exists():
        words = [*words, "--resume"]
    with redirect_stdout(sys.stderr):  # stdout is for tables
        collect.main(words)
