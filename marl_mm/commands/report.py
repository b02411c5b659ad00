"""marl-mm report: all results on one page of HTML."""

from pathlib import Path

from marl_mm.commands.parser import command
from marl_mm.eval.studies.report import report_page
from marl_mm.files import new_file, refuse_existing


@command
def main(
    *,
    results: Path = Path("eval/results"),
    out: Path = Path("runs/report.html"),
    videos: tuple[Path, ...] = (),
    overwrite: bool = False,
) -> None:
    """Put tables and figures of results on one page that needs no other file.

    With them: what the runs were made of, versions, and the command that makes each.
    The online learners' speed is not among them.

    Args:
        results: Folder of results: what "marl-mm ablate all --out" fills, and more.
        out: The page.
        videos: Films to show, such as "marl-mm play" and "marl-mm quickstart" make.
        overwrite: Replace a page that exists.
    """
    refuse_existing(out, overwrite, file=True)
    page = report_page(results, videos)
    with new_file(out) as temporary:
        temporary.write_text(page, "utf-8")
    print(f"{out}: {len(page) / 1e6:.1f} MB, open it in a browser")
