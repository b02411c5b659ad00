"""marl-mm report: all results on one page of HTML."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from marl_mm.commands.parser import parse_options
from marl_mm.eval.studies.report import report_page
from marl_mm.files import new_file, refuse_existing


@dataclass(frozen=True)
class Report:
    """Put every table and figure on one page that needs no network and no other file.

    With them: what the runs were made of, cards of the datasets, versions, and the
    command that makes each.
    """

    results: Path = Path("eval/results")
    """Folder of results: what "marl-mm ablate all --out" fills, and more."""

    out: Path = Path("runs/report.html")
    """The page."""

    videos: tuple[Path, ...] = ()
    """Films to show, such as "marl-mm play" and "marl-mm quickstart" make."""

    overwrite: bool = False
    """Replace a page that exists."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm report``."""
    options = parse_options(Report, "marl-mm report", arguments)
    refuse_existing(options.out, options.overwrite)
    page = report_page(options.results, options.videos)
    with new_file(options.out) as temporary:
        temporary.write_text(page)
    print(f"{options.out}: {len(page) / 1e6:.1f} MB, open it in a browser")
