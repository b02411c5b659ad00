"""marl-mm cache: what was derived from datasets, and its deletion."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from marl_mm.commands.parser import parse_options
from marl_mm.datasets import cache


@dataclass(frozen=True)
class Cache:
    """Show what was derived from datasets to read them quickly, or delete it.

    It lies in $MARL_MM_CACHE, or in marl_mm in the user's cache folder. At most 5 GB
    are kept, or as many as $MARL_MM_CACHE_GB says. What was not used for longest
    goes first, and is made again when it is needed.
    """

    clear: bool = False
    """Delete everything in it."""

    json: bool = False
    """Print JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm cache``."""
    options = parse_options(Cache, "marl-mm cache", arguments)
    entries, most = cache.entries(), cache.most_bytes()
    if options.clear:
        cache.clear()
    size = sum(entry.size for entry in entries)
    values = {
        "folder": str(cache.cache_folder()),
        "cleared": options.clear,
        "entries": len(entries),
        "bytes": size,
        "most_bytes": most,
    }
    if options.json:
        print(json.dumps(values, indent=2))
        return
    text = f"{len(entries)} datasets, {size / 1e6:,.1f} MB of at most {most / 1e6:,.0f}"
    print(f"{'deleted ' * options.clear}{text}, in {values['folder']}")
    if not options.clear:
        for entry in entries:
            used = datetime.fromtimestamp(entry.used).isoformat(" ", "minutes")
            print(f"{entry.path.name}  {entry.size / 1e6:8.1f} MB  used {used}")
