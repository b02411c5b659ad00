"""The pages that are made of registries and committed results.

``python tools/pages.py`` in a clone writes them: reference pages, drawings, and tables
that stand between ``<!-- NAME -->`` and ``<!-- /NAME -->`` in README.md and docs/.
``--check`` only says which are not up to date, and fails if any is not.
"""

import sys
from pathlib import Path

from drawings import DRAWINGS
from named_pages import PAGES as NAMED_PAGES
from reference_pages import PAGES
from result_tables import TABLES
from task_pages import PAGES as TASK_PAGES
from who_sees import PICTURES

from marl_mm.files import new_file

ROOT = Path(__file__).resolve().parents[1]


def filled(text: str) -> str:
    """The text with every table between its marks."""
    for name, make in TABLES.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
        before, mark, rest = text.partition(begin)
        if mark:
            text = before + begin + make() + end + rest.partition(end)[2]
    return text


def pages() -> dict[Path, str]:
    """Every page that is made, or has tables, as it should be."""
    made = {
        ROOT / "docs" / name: make()
        for name, make in (
            PAGES | NAMED_PAGES | TASK_PAGES | DRAWINGS | PICTURES
        ).items()
    }
    written = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    made |= {p: p.read_text("utf-8") for p in written if p not in made}
    return {path: filled(text) for path, text in made.items()}


def main() -> int:
    """Write what is not up to date, or only name it."""
    stale = [
        (path, text)
        for path, text in pages().items()
        if not path.exists() or path.read_text("utf-8") != text
    ]
    for path, text in stale:
        print(path.relative_to(ROOT))
        if "--check" not in sys.argv:
            path.parent.mkdir(parents=True, exist_ok=True)
            with new_file(path) as temporary:
                temporary.write_text(text, "utf-8")
    return int("--check" in sys.argv and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
