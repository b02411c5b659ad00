"""marl-mm board: submissions side by side on a page."""

from pathlib import Path

import tyro

from marl_mm.commands.parser import command
from marl_mm.progress import progress_bars
from marl_mm.runs.board import board


@command
def main(
    folders: tyro.conf.Positional[tuple[Path, ...]],
    *,
    out: Path = Path("board"),
    films: bool = False,
    overwrite: bool = False,
) -> None:
    """Make a page of submissions: success, tie groups, verdicts, films, rows.

    It needs no network and no server. Verdicts are those that "marl-mm verify" left
    beside the folders.

    Args:
        folders: Folders of submissions.
        out: Folder of the page.
        films: Film an episode of each submission's first seed.
        overwrite: Replace an older board.
    """
    with progress_bars() as bar:
        made = board(folders, out=out, films=films, overwrite=overwrite, progress=bar)
    count = sum(map(len, made.sections))
    plural = "s" if count != 1 else ""
    print(f"{made.page}: {count} submission{plural}, open it in a browser")
