"""The user's cache: episodes of datasets as flat arrays, which are read quickly.

It lies in ``$MARL_MM_CACHE``, or in ``marl_mm`` in the user's cache folder, and never
in a dataset's folder. An entry is named after a hash of the data file's bytes, which is
taken at each reading; checksums within it show damage.
"""

import hashlib
import json
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from marl_mm.datasets.arrays import EpisodeArrays, load_arrays, save_arrays
from marl_mm.errors import DatasetError, UsageError
from marl_mm.files import home, new_file
from marl_mm.layout import Layout
from marl_mm.received import check_regular
from marl_mm.temporary import remove_left

FOLDER_VARIABLE = "MARL_MM_CACHE"
"""Environment variable with the folder of the cache."""

SIZE_VARIABLE = "MARL_MM_CACHE_GB"
"""Environment variable with the largest size of the cache [GB]; 0: no cache."""

_SIZE = 5.0
"""Default of the largest size [GB]."""

_FORM = 2
"""Version of the entries, and of the checks before they are stored; those of other
versions are not found."""


_PART = ".part.npz"
"""Ending of an entry that is being written."""


@dataclass(frozen=True)
class Entry:
    """A dataset's episodes in the cache."""

    path: Path
    """File of the arrays."""

    size: int
    """Size of the file [bytes]."""

    used: float
    """Time of the last use [s since 1970]."""


def cache_folder() -> Path:
    """Folder of the cache, whether it exists or not."""
    if folder := os.environ.get(FOLDER_VARIABLE):
        return Path(folder) / "datasets"
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else home() / ".cache") / "marl_mm" / "datasets"


def most_bytes() -> int:
    """Largest size of all entries together [bytes].

    Raises:
        UsageError: If ``$MARL_MM_CACHE_GB`` is no number.
    """
    text = os.environ.get(SIZE_VARIABLE, str(_SIZE))
    try:
        size = float(text)
    except ValueError:
        size = -1.0
    if not 0 <= size < 1e9:
        raise UsageError(f"{SIZE_VARIABLE} is {text!r}, expected a size in GB, or 0")
    return int(size * 1e9)


def entries() -> list[Entry]:
    """All entries, those that were used last first."""
    listed = []
    for path in cache_folder().glob("[!.]*.npz"):
        with suppress(OSError):  # deleted by another process
            status = path.lstat()
            listed.append(Entry(path, status.st_size, status.st_mtime))
    return sorted(listed, key=lambda entry: (-entry.used, entry.path))


def clear() -> None:
    """Delete all entries, and what killed processes left of some."""
    for entry in entries():
        entry.path.unlink(missing_ok=True)
    for path in cache_folder().glob(f".*{_PART}"):
        remove_left(path.parent, path.name[1:].split(".")[0], _PART)


@dataclass(frozen=True)
class Key:
    """All that the arrays of a dataset are made of."""

    digest: str
    """SHA-256 of the data file, in hex digits."""

    episodes: int
    """Number of episodes."""

    info: Sequence[str]
    """Names of the step numbers."""

    layout: Layout
    """Layout of states and actions."""

    @property
    def name(self) -> str:
        """Name of the entry."""
        made_of = [_FORM, self.digest, self.episodes, [*self.info]]
        text = json.dumps([*made_of, self.layout.to_json()])
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def cached(key: Key) -> EpisodeArrays | None:
    """The arrays of a dataset; None if the cache is off, or they are not whole there.

    Raises:
        UsageError: If ``$MARL_MM_CACHE_GB`` is no number.
    """
    if not most_bytes():
        return None
    path = cache_folder() / f"{key.name}.npz"
    try:
        check_regular(path, DatasetError)
        arrays = load_arrays(path, key.layout)
    except (DatasetError, OSError):  # it is made again
        return None
    with suppress(OSError):  # somebody else's cache
        os.utime(path)
    return arrays


def keep(key: Key, arrays: EpisodeArrays) -> None:
    """Store the arrays of a dataset, and delete those that were not used for long.

    Without room or permission, nothing is stored.

    Raises:
        UsageError: If ``$MARL_MM_CACHE_GB`` is no number.
    """
    most, size = most_bytes(), 0
    if arrays.nbytes > most:
        return
    with suppress(OSError):
        with new_file(cache_folder() / f"{key.name}.npz") as temporary:
            save_arrays(temporary, arrays, compress=False)
        for entry in entries():
            size += entry.size
            if size > most:
                entry.path.unlink(missing_ok=True)
