"""Build the named datasets and write what they gave into datasets/recipes.json.

Run ``python tools/publish_datasets.py [NAME...]``; default all that are not on record.
What is finished is on record at once, so that a stopped call is gone on with.
"""

import json
import sys

from marl_mm.datasets.named import RECORD
from marl_mm.files import new_file
from marl_mm.progress import progress_bars
from marl_mm.runs.recipes import RECIPES, build_dataset, recorded


def main() -> None:
    """Build, and record."""
    missing = [name for name in RECIPES.names() if name not in recorded()]
    with progress_bars() as bar:
        for name in sys.argv[1:] or missing:
            row = build_dataset(name, workers=2, progress=bar).row
            rows = recorded() | {name: row}
            order = [other for other in RECIPES.names() if other in rows]
            with new_file(RECORD) as temporary:
                text = json.dumps({n: rows[n] for n in order}, indent=1)
                temporary.write_text(f"{text}\n", "utf-8")
            print(name, row)


if __name__ == "__main__":
    main()
