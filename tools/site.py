"""MkDocs hook: links of pages to files outside of docs/ lead to copies in the site.

A page may link to ``../eval/results/online/fig5.png`` as it does for those who read it
in the repository; the site has the file as ``files/eval/results/online/fig5.png``.
"""

import os
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
LINK = re.compile(r"(\]\()(\.\./[^)#\s]+)")


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """The page's text with such links turned to the copies, which are added."""
    source = Path(page.file.src_uri)

    def turned(link: re.Match[str]) -> str:
        path = (DOCS / source.parent / link[2]).resolve()
        if path.is_relative_to(DOCS) or not path.is_file():
            return link[0]  # a page, or a mistake, of which MkDocs warns
        name = f"files/{path.relative_to(ROOT).as_posix()}"
        if files.get_file_from_path(name) is None:
            files.append(File.generated(config, name, abs_src_path=str(path)))
        return link[1] + os.path.relpath(name, source.parent)

    return LINK.sub(turned, markdown)
