"""Copy a collected dataset into the package as the one that ships.

First run ``marl-mm collect pretrained --steps 5000 --dataset
marl_mm/reach/good-5k-v0``, then ``python -m marl_mm.datasets.make_shipped``.
"""

from marl_mm.datasets.arrays import save_arrays
from marl_mm.datasets.location import SHIPPED, locate
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.shipped import ARRAYS, DESCRIPTION
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
    """Compress the dataset with the shipped one's id into the package."""
    location = locate(SHIPPED)
    metadata = read_metadata(location)
    with new_file(ARRAYS) as temporary:
        save_arrays(temporary, read_arrays(location, metadata), compress=True)
    record = metadata["marl_mm"].items()
    write_json(DESCRIPTION, {k: v for k, v in record if k not in _DERIVED})


if __name__ == "__main__":
    main()
