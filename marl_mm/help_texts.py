"""Help of commands as long as the terminal's lines, not as the source's.

Tyro keeps the line breaks of docstrings, which then stand beside its own, and prints a
command's description as it is.
"""

import re
import shutil
import textwrap
from collections.abc import Callable
from dataclasses import replace

from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

FLOWING = ConstructorRegistry()
"""Rules by which tyro takes each paragraph of a field's docstring as one line."""

_asked: list[StructTypeInfo] = []
"""Types that tyro's own rules are asked about."""


def joined(text: str, indent: int = 0) -> str:
    """A text without marks of code, and breaks before lines indented as deep."""
    return re.sub(rf"(?<!\n)\n {{{indent},}}(?=\S)", " ", text).replace("``", "")


def filled(text: str) -> str:
    """A description as wide as the terminal.

    Tyro joins lines that begin with a letter: all but the first are indented.
    """
    columns = shutil.get_terminal_size().columns
    return "\n\n".join(
        textwrap.fill(paragraph, columns, subsequent_indent="  ")
        for paragraph in joined(text).split("\n\n")
    )


@FLOWING.struct_rule
def _flowing(info: StructTypeInfo) -> StructConstructorSpec | None:
    if any(info is asked for asked in _asked):
        return None
    _asked.append(info)
    try:
        spec = ConstructorRegistry.get_struct_spec(info)
    finally:
        _asked.pop()
    if not isinstance(spec, StructConstructorSpec):
        return None
    fields = (replace(each, helptext=_joined_later(each)) for each in spec.fields)
    return replace(spec, fields=tuple(fields))


def _joined_later(field: StructFieldSpec) -> Callable[[], str | None]:
    def text() -> str | None:
        found = field.helptext() if callable(field.helptext) else field.helptext
        return found and joined(found)

    return text
