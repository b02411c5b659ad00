"""The catalogue of datasets below the root, unfinished ones included, and deletion."""

import shutil
from typing import Any

from marl_mm.datasets import shipped
from marl_mm.datasets.journal import begun
from marl_mm.datasets.location import (
    ID,
    Location,
    datasets_root,
    known_ids,
    locate,
)
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import refuse_foreign
from marl_mm.errors import MarlMmError, UnknownDatasetError, UsageError
from marl_mm.files import only_here
from marl_mm.sim.config import RECORDED_ENGINE
from marl_mm.temporary import remove

_BEGUN = "being collected, or stopped: go on with `marl_mm.collect(..., resume=True)`"


def catalogue() -> list[dict[str, Any]]:
    """A row of id, engine, steps, episodes and a note for each dataset, by id.

    Datasets that ship are the last rows until their first use.
    """
    under_way = begun()
    rows = [_row(name) for name in known_ids() if name not in under_way]
    rows += [
        {"id": name, "engine": None, "steps": None, "episodes": count, "note": _BEGUN}
        for name, count in under_way.items()
    ]
    rows.sort(key=lambda row: row["id"])
    note = "ships with marl_mm: written here at its first use"
    rows += [
        {"id": name, **shipped.shipped_row(name), "note": note}
        for name in shipped.IDS
        if not locate(name).folder.exists()
    ]
    return rows


def _row(name: str) -> dict[str, Any]:
    try:
        record = read_metadata(Location(name, datasets_root() / name))["marl_mm"]
    except MarlMmError as error:
        nothing = dict.fromkeys(("engine", "steps", "episodes"))
        return {"id": name, **nothing, "note": str(error)}
    stopped = "" if record.get("complete") else "of a collection that was stopped"
    return {
        "id": name,
        "engine": Provenance.from_json(record).engine or RECORDED_ENGINE,
        "steps": record["steps"],
        "episodes": record["episodes"],
        "note": stopped if ID.fullmatch(name) else "no id: it is named by its path",
    }


def check_deletable(location: Location) -> None:
    """Raise if a location holds neither a dataset nor a stopped collection.

    Raises:
        UnknownDatasetError: If the location does not exist.
        UsageError: If the location holds something else.
    """
    if location.folder.is_symlink():
        return
    if not location.folder.exists() and not location.working.exists():
        raise UnknownDatasetError(f"no dataset {location.name!r} to delete")
    refuse_foreign(location)
    if location.folder.exists() and not location.data.is_dir():
        raise UsageError(f"{location.folder} is no dataset: it is not deleted")


def delete(location: Location) -> None:
    """Delete a dataset, and the journal of a stopped collection into it.

    Of a link to a dataset, only the link is deleted.

    Raises:
        UnknownDatasetError: If the location does not exist.
        UsageError: If the location holds something else, or another process writes it.
    """
    check_deletable(location)
    with only_here(location.working):
        if location.folder.is_symlink():
            location.folder.unlink()
        elif location.folder.exists():
            for path in location.folder.iterdir():
                if path != location.data:
                    remove(path)
            shutil.rmtree(location.folder)  # by its data it is known until the end
        shutil.rmtree(location.working)
