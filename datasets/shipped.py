"""The datasets that ship, so that offline training starts without collecting.

They are compressed arrays in the package. The first use of an id writes it below the
datasets' root, where Minari finds it, too. ``make_shipped`` makes the files anew.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays, load_arrays
from marl_mm.datasets.location import SHIPPED, Location
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.envs.registry import make_task
from marl_mm.files import only_here, refuse_existing
from marl_mm.sim.config import RECORDED_ENGINE

_FOLDER = Path(__file__).parent / "shipped"

_NAMES = {
    SHIPPED: "good-5k",
    "marl_mm/quiet-zone/noisy-v0": "quiet-zone-noisy",
    "marl_mm/gate/expert-v0": "gate-expert",
    "marl_mm/bar/conventions-v0": "bar-conventions",
}
"""Names of files by ids of datasets: 5,000 steps of the pretrained agent, and some of
the named ones."""

IDS = tuple(_NAMES)
"""Ids of the datasets that ship."""


def arrays_file(name: str = SHIPPED) -> Path:
    """File of a dataset's arrays, by its id."""
    return _FOLDER / f"{_NAMES[name]}.npz"


def description_file(name: str = SHIPPED) -> Path:
    """File of what a dataset was made of, by its id."""
    return _FOLDER / f"{_NAMES[name]}.json"


def install(location: Location) -> None:
    """Write a dataset that ships, unless it exists by now.

    Args:
        location: Location of one of ``IDS``.
    """
    refuse_existing(location.folder, overwrite=True)  # whether its folder is writable
    with only_here(location.working, wait=True):
        if not location.folder.exists():
            arrays = shipped_arrays(location.id)
            write_dataset(location, arrays, _provenance(location.id))
        if not any(location.working.iterdir()):
            location.working.rmdir()


def shipped_arrays(name: str = SHIPPED) -> EpisodeArrays:
    """The episodes of a dataset that ships, by its id."""
    return load_arrays(arrays_file(name), make_task(_provenance(name).task).layout)


def shipped_row(name: str) -> dict[str, Any]:
    """Engine, steps and episodes of a dataset that ships, by its id."""
    with np.load(arrays_file(name)) as arrays:
        lengths = arrays["lengths"]
    engine = _provenance(name).engine or RECORDED_ENGINE
    return {"engine": engine, "steps": int(lengths.sum()), "episodes": len(lengths)}


def _provenance(name: str) -> Provenance:
    return Provenance.from_json(json.loads(description_file(name).read_text("utf-8")))
