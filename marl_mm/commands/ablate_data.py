"""The datasets that ablations learn from: what is missing is collected first."""

import shlex
import sys
from contextlib import redirect_stdout

from marl_mm.commands import collect
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import locate
from marl_mm.errors import UnknownDatasetError
from marl_mm.eval.ablations import made_by


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
    location = locate(name)
    words += ["--workers", str(workers)]
    if location.folder.exists() or location.working.exists():
        words.append("--resume")
    with redirect_stdout(sys.stderr):  # stdout is for tables
        collect.main(words)
    return load_dataset(name)
