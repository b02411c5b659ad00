"""Copy datasets into the package as those that ship.

First run ``marl-mm collect pretrained --steps 5000 --dataset
marl_mm/reach/good-5k-v0``, or ``marl-mm datasets build NAME``, then ``python -m
marl_mm.datasets.make_shipped ID...``.
"""

import sys

from marl_mm.datasets.arrays import save_arrays
from marl_mm.datasets.location import locate
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.shipped import arrays_file, description_file
from marl_mm.datasets.storage import read_arrays
from marl_mm.files import new_file, write_json

_DERIVED = frozenset(
    {
        "schema",
        "layout",
        "info",
        "statistics",
        "episodes",
        "steps",
        "data_sha256",
        "metadata_sha256",
    }
)
"""Keys that are computed anew when the dataset is unpacked."""


def main() -> None:
    """Compress the datasets with the ids that are named into the package."""
    for name in sys.argv[1:]:
        location = locate(name)
        metadata = read_metadata(location)
        with new_file(arrays_file(name)) as temporary:
            save_arrays(temporary, read_arrays(location, metadata), compress=True)
        record = metadata["marl_mm"].items()
        kept = {k: v for k, v in record if k not in _DERIVED}
        write_json(description_file(name), kept)


if __name__ == "__main__":
    main()
