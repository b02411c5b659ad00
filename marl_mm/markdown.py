"""Texts that may come from strangers as parts of Markdown."""

import re


def one_line(text: str) -> str:
    """A text with its line breaks as spaces."""
    return " ".join(text.splitlines())


def literal(text: str) -> str:
    """A text that Markdown shows as it is, on one line.

    No cell, link, picture, emphasis or HTML begins in it.
    """
    text = one_line(text).replace("&", "&amp;").replace("<", "&lt;")
    return re.sub(r"[\\|`*~\[\]]|(?<!\w)_|_(?!\w)", r"\\\g<0>", text)
