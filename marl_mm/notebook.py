"""HTML for notebooks: tables and pictures, with every text escaped."""

import base64
from collections.abc import Iterable, Sequence
from html import escape


def html_table(rows: Iterable[Sequence[str]], header: Sequence[str] = ()) -> str:
    """A table of texts, which may come from strangers."""
    lines = [_line("th", header)] if header else []
    lines += [_line("td", row) for row in rows]
    return f"<table>{''.join(lines)}</table>"


def html_picture(png: bytes, text: str) -> str:
    """A PNG as part of the page, and a text for those who cannot see it."""
    data = base64.b64encode(png).decode()
    source = f"data:image/png;base64,{data}"
    return f'<img alt="{escape(text)}" src="{source}" style="max-width: 100%">'


def _line(kind: str, texts: Sequence[str]) -> str:
    cells = (f"<{kind}>{escape(text)}</{kind}>" for text in texts)
    return f"<tr>{''.join(cells)}</tr>"
