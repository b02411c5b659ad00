"""Where a dataset is: an id below the datasets' root, or a path.

A text like ``marl_mm/reach/pd-v0`` is an id; one that starts with ``.``, ``/`` or
``~``, or does not look like an id, is a path.
"""

import os
import re
from dataclasses import dataclass
from pathlib import Path

from marl_mm.errors import UsageError

_ID = re.compile(r"([a-zA-Z0-9_-]{2,}/)+[a-zA-Z0-9_-]+-v\d+")


@dataclass(frozen=True)
class Location:
    """A dataset's id and folder."""

    id: str
    folder: Path

    @property
    def data(self) -> Path:
        """Minari's folder within, with the HDF5 file and its metadata."""
        return self.folder / "data"

    @property
    def working(self) -> Path:
        """What a collection into the folder keeps while it is under way."""
        return self.folder.with_name(f".{self.folder.name}.collecting")


def datasets_root() -> Path:
    """``$MINARI_DATASETS_PATH``, or Minari's default in the home folder."""
    root = os.environ.get("MINARI_DATASETS_PATH")
    return Path(root).resolve() if root else Path.home() / ".minari" / "datasets"


def locate(text: str) -> Location:
    """The location an id or a path means, whether it exists or not.

    Raises:
        UsageError: If the text is empty, or an id of ours without a version.
    """
    if not text:
        raise UsageError("the dataset's name is empty, expected an id or a path")
    if _ID.fullmatch(text):
        return Location(text, datasets_root() / text)
    if text.startswith("marl_mm/"):
        raise UsageError(f"{text!r} looks like an id without its version, as in -v0")
    folder = Path(text).expanduser().resolve()
    if folder.name == "data" and (folder / "metadata.json").exists():
        folder = folder.parent
    name = re.sub(r"[^a-zA-Z0-9_-]", "-", folder.name)
    versioned = name if re.search(r"-v\d+$", name) else f"{name}-v0"
    return Location(f"marl_mm/local/{versioned}", folder)


def find(text: str) -> Location:
    """The location of a dataset to read: also by the last part of its id alone.

    ``good`` means ``marl_mm/reach/good-v0`` where there is that and no folder ``good``.

    Raises:
        UsageError: If the text is empty, or an id of ours without a version.
    """
    location = locate(text)
    short = Path(f"marl_mm/reach/{text}-v0")
    if not location.folder.exists() and (datasets_root() / short).exists():
        return locate(short.as_posix())
    return location


def known_ids() -> list[str]:
    """Ids of all datasets below the root, sorted."""
    root = datasets_root()
    found = root.glob("**/data/metadata.json") if root.exists() else []
    folders = (path.parent.parent.relative_to(root) for path in found)
    return sorted(f.as_posix() for f in folders if not f.name.startswith("."))
