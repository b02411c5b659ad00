"""MkDocs hook: notebooks as pages, and links to files outside of docs/.

A page may link to ``../eval/results/studies/fig5.png`` as it does for those who read it
in the repository; the site has the file as ``files/eval/results/studies/fig5.png``. A
notebook ``docs/notebooks/NAME.ipynb`` is shown as the page ``notebooks/NAME.html``.
"""

import json
import os
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
OUTSIDE = re.compile(r"(\]\()(\.\./[^)#\s]+)")
NOTEBOOK = re.compile(r"(\]\([\w./-]+)\.ipynb\)")


def on_files(files: Any, config: Any) -> Any:
    """Show every notebook as a page beside it."""
    for path in sorted((DOCS / "notebooks").glob("*.ipynb")):
        text = notebook_page(path)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """The page's text with links to such files turned to where the site has them."""
    source = Path(page.file.src_uri)

    def turned(link: re.Match[str]) -> str:
        path = (DOCS / source.parent / link[2]).resolve()
        if path.is_relative_to(DOCS) or not path.is_file():
            return link[0]  # a page, or a mistake, of which MkDocs warns
        name = f"files/{path.relative_to(ROOT).as_posix()}"
        if files.get_file_from_path(name) is None:
            files.append(File.generated(config, name, abs_src_path=str(path)))
        return link[1] + os.path.relpath(name, source.parent)

    return NOTEBOOK.sub(r"\1.md)", OUTSIDE.sub(turned, markdown))


def notebook_page(path: Path) -> str:
    """A notebook as Markdown, with its outputs."""
    cells = json.loads(path.read_text("utf-8"))["cells"]
    parts = [part for cell in cells for part in _cell(cell)]
    download = f'<a href="{path.name}" download>Download this notebook</a>'
    return "\n\n".join((parts[0], download, *parts[1:])) + "\n"


def _cell(cell: dict[str, Any]) -> list[str]:
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        return [source]
    return [f"```python\n{source}\n```", *map(_output, cell["outputs"])]


def _output(output: dict[str, Any]) -> str:
    """An output: as HTML or as a picture where it is one, else as text."""
    if output["output_type"] == "stream":
        return _text("".join(output["text"]))
    data = {kind: "".join(text) for kind, text in output["data"].items()}
    if "text/html" in data:
        lines = [line for line in data["text/html"].splitlines() if line.strip()]
        return '<div class="output">' + "\n".join(lines) + "</div>"
    if "image/png" in data:
        return f'<img alt="" src="data:image/png;base64,{data["image/png"].strip()}">'
    return _text(data.get("text/plain", ""))


def _text(text: str) -> str:
    return f"```text\n{text.rstrip()}\n```"
