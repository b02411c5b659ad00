"""Locations of datasets: an id below the datasets' root, or a path.

A text such as ``marl_mm/reach/pd-v0`` is an id. The name of a recipe, such as
``gate-noisy``, is short for its id, and any other plain word, such as ``pd``, for
``marl_mm/reach/WORD-v0``. Everything else, such as ``./pd``, is a path.
"""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from marl_mm.datasets.named import named_ids
from marl_mm.errors import UsageError
from marl_mm.files import home
from marl_mm.words import refuse_control_characters

SHIPPED = "marl_mm/reach/good-5k-v0"
"""Id of the dataset that ships; its first use writes it below the root."""

ID = re.compile(r"([a-zA-Z0-9_-]{2,}/)+[a-zA-Z0-9_-]+-v\d+")
"""Form of ids."""

_WORD = re.compile(r"[a-zA-Z0-9_][a-zA-Z0-9_-]*")


@dataclass(frozen=True)
class Location:
    """Id and folder of a dataset."""

    id: str
    """Id of the dataset, such as ``marl_mm/reach/pd-v0``."""

    folder: Path
    """Folder of the dataset."""

    @property
    def data(self) -> Path:
        """Folder with Minari's HDF5 file and metadata."""
        return self.folder / "data"

    @property
    def name(self) -> str:
        """Name that finds it: the id below the datasets' root, the path elsewhere."""
        below_root = self.folder == datasets_root() / self.id
        return self.id if below_root else str(self.folder)

    @property
    def working(self) -> Path:
        """Folder of the journal while a collection is in progress."""
        return self.folder.with_name(f".{self.folder.name}.collecting")


def datasets_root() -> Path:
    """``$MINARI_DATASETS_PATH``, or Minari's default in the home folder."""
    root = os.environ.get("MINARI_DATASETS_PATH")
    return (Path(root) if root else home() / ".minari" / "datasets").resolve()


def text_of(name: str | Path) -> str:
    """What ``locate`` takes for this: a ``Path`` is a path, whatever it is called."""
    return str(name.absolute()) if isinstance(name, Path) else name


def locate(text: str) -> Location:
    """Location of an id, a short name or a path, whether it exists or not.

    The word of a named dataset, such as gate-noisy, is short for its id,
    ``marl_mm/gate/noisy-v0``; any other, such as pd, for ``marl_mm/reach/pd-v0``.

    Raises:
        UsageError: If the text is empty, has a line break or another control
            character, or begins like an id of ours and is none.
    """
    if not text:
        raise UsageError("the dataset's name is empty, expected an id or a path")
    refuse_control_characters("the dataset's name", text)
    if _WORD.fullmatch(text):
        text = named_ids().get(text) or f"marl_mm/reach/{_versioned(text)}"
    if ID.fullmatch(name := text.rstrip("/")):
        return Location(name, datasets_root() / name)
    if text.startswith("marl_mm/"):
        raise UsageError(
            f"{text!r} is no id, expected marl_mm/FOLDER/NAME-v0 of letters, digits, _ "
            "and -, and two or more of them in FOLDER"
        )
    try:
        folder = _absolute(Path(text).expanduser())
    except RuntimeError as error:  # such as of ~nobody
        raise UsageError(f"dataset {text!r}: {error}") from None
    if not folder.name:
        raise UsageError(f"dataset {text!r} is no name, expected an id or a path")
    if folder.name == "data" and (folder / "metadata.json").exists():
        folder = folder.parent
    if folder.is_relative_to(root := datasets_root()):
        inner = str(folder.relative_to(root))
        if ID.fullmatch(inner):
            return Location(inner, folder)
    name = re.sub(r"[^a-zA-Z0-9_-]", "-", folder.name)
    return Location(f"marl_mm/local/{_versioned(name)}", folder)


def find(text: str) -> Location:
    """Location of a dataset to read; a word may also name a folder in this one.

    Raises:
        UsageError: If the text is empty, or begins like an id of ours and is none.
    """
    location = locate(text)
    here = Path(text, "data", "metadata.json")
    if location.folder.exists() or location.working.exists() or not here.exists():
        return location
    return locate(f"./{text}")


def known_ids() -> list[str]:
    """Ids of all datasets below the datasets' root, sorted."""
    root = datasets_root()
    files = found("data/metadata.json")
    folders = (path.parent.parent.relative_to(root) for path in files)
    return sorted(f.as_posix() for f in folders if not f.name.startswith("."))


def found(name: str) -> Iterator[Path]:
    """Files of a name in folders below the datasets' root, and in those linked there.

    Args:
        name: Path within a folder.
    """
    root = datasets_root()
    inside: dict[str, tuple[str, ...]] = {str(root.parent): ()}
    for folder, names, _ in os.walk(root, followlinks=True):
        real, above = os.path.realpath(folder), inside[os.path.dirname(folder)]
        if real in above:  # links in a circle
            names.clear()
            continue
        inside[folder] = (*above, real)
        if os.path.exists(path := os.path.join(folder, name)):  # and may be looked at
            yield Path(path)


def _absolute(path: Path) -> Path:
    """The path with links resolved, but for the last one, which can be deleted."""
    if path.name in ("", "..") or not path.is_symlink():
        return path.resolve()
    return path.parent.resolve() / path.name


def _versioned(name: str) -> str:
    return name if re.search(r"-v\d+$", name) else f"{name}-v0"
