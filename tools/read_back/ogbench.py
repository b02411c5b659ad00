"""Reads an export with OGBench's ``load_dataset``; see ``reference.py``.

Rewards and masks are not among the keys that it loads, and are read with numpy.
"""

import sys

here = sys.path.pop(0)  # or this file would be imported in place of the library
import numpy as np  # noqa: E402
from ogbench.utils import load_dataset  # noqa: E402

sys.path.append(here)
from compare import ends, report  # noqa: E402

exported, reference = sys.argv[1:]
known, file = np.load(reference), np.load(exported)
last = ends(known["lengths"])
compact = load_dataset(exported, compact_dataset=True)
steps = compact["valids"].astype(bool)
more = {key: file[key][steps] for key in ("rewards", "masks")}
keys = ("observations", "actions", "next_observations")
report(
    "ogbench",
    load_dataset(exported) | more | {"compact": compact["observations"][steps]},
    {
        **{key: known[key] for key in keys},
        "terminals": last,
        "rewards": known["rewards"],
        "masks": ~known["terminals"],
        "compact": known["observations"],
    },
)
