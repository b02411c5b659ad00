"""marl-mm cache: what was derived from datasets, and its deletion."""

from datetime import datetime

from marl_mm.commands.output import show
from marl_mm.commands.parser import command
from marl_mm.datasets import cache


@command
def main(*, clear: bool = False, json: bool = False) -> None:
    """Show what was derived from datasets to read them quickly, or delete it.

    It lies in $MARL_MM_CACHE, or in marl_mm in the user's cache folder. At most 5 GB
    are kept, or as many as $MARL_MM_CACHE_GB says. What was not used for longest goes
    first, and is made again when it is needed.

    Args:
        clear: Delete everything in it.
        json: Print JSON.
    """
    entries, most = cache.entries(), cache.most_bytes()
    if clear:
        cache.clear()
    size = sum(entry.size for entry in entries)
    values = {
        "folder": str(cache.cache_folder()),
        "cleared": clear,
        "entries": len(entries),
        "bytes": size,
        "most_bytes": most,
    }
    text = (
        f"{'deleted ' * clear}{len(entries)} datasets, {size / 1e6:,.1f} MB of at most "
        f"{most / 1e6:,.0f}, in {values['folder']}"
    )
    lines = [_line(entry) for entry in entries] if not clear else []
    show(values, "\n".join([text, *lines]), json)


def _line(entry: cache.Entry) -> str:
    used = datetime.fromtimestamp(entry.used).isoformat(" ", "minutes")
    return f"{entry.path.name}  {entry.size / 1e6:8.1f} MB  used {used}"
