"""The dataset that ships, so that offline training starts without collecting.

It has 5,000 steps of the pretrained agent, as compressed arrays in the package. The
first use of its name, ``good-5k``, writes it below the datasets' root, where Minari
finds it, too. ``make_shipped`` makes the file anew.
"""

import json
from pathlib import Path

from marl_mm.datasets.arrays import EpisodeArrays, load_arrays
from marl_mm.datasets.location import Location
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.envs.registry import make_task
from marl_mm.files import only_here

FOLDER = Path(__file__).parent / "shipped"
ARRAYS = FOLDER / "good-5k.npz"
DESCRIPTION = FOLDER / "good-5k.json"


def install(location: Location) -> None:
    """Write the dataset that ships, unless it exists by now.

    Args:
        location: Location of ``SHIPPED``.
    """
    with only_here(location.working, wait=True):
        if not location.folder.exists():
            write_dataset(location, shipped_arrays(), _provenance())
        if not any(location.working.iterdir()):
            location.working.rmdir()


def shipped_arrays() -> EpisodeArrays:
    """The episodes of the dataset that ships."""
    return load_arrays(ARRAYS, make_task(_provenance().task).layout)


def _provenance() -> Provenance:
    return Provenance.from_json(json.loads(DESCRIPTION.read_text()))
