"""Help and rows in the width of the terminal.

Tyro keeps the line breaks of docstrings, which then stand beside its own, and prints a
command's description as it is.
"""

import re
import shutil
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, get_args

from tyro.conf import arg
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from marl_mm.received import printable_name

if TYPE_CHECKING:  # a help does without
    from rich.table import Table
    from rich.text import Text

FLOWING = ConstructorRegistry()
"""Rules by which tyro takes each paragraph of a field's docstring as one line.

None, the default of options whose help says what it means, is not shown.
"""

_FRAME = 5
"""Lines of a table beside its rows: title, heading and rules."""

_asked: list[Any] = []
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
        textwrap.fill(
            paragraph, columns, subsequent_indent="  ", break_on_hyphens=False
        )
        for paragraph in joined(text).split("\n\n")
    )


def without_hint(kind: Any, default: Any) -> Any:
    """An option's type, for a help without its default where that says nothing."""
    if default is None or default == ():
        return Annotated[kind, arg(help_behavior_hint="")]
    return kind


@FLOWING.struct_rule
def _flowing(info: StructTypeInfo) -> StructConstructorSpec | None:
    spec = _of_other_rules(ConstructorRegistry.get_struct_spec, info)
    if not isinstance(spec, StructConstructorSpec):
        return None
    return replace(spec, fields=tuple(map(_flowing_field, spec.fields)))


@FLOWING.primitive_rule
def _without_none(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    # What may be left out is shown as what it is if it is given.
    if type(None) not in get_args(info.type):
        return None
    spec = _of_other_rules(ConstructorRegistry.get_primitive_spec, info)
    if not isinstance(spec, PrimitiveConstructorSpec):
        return None
    metavar = re.sub(r"^\{None\}\|(?:\{(.* .*)\}$)?", r"\1", spec.metavar)
    return replace(spec, metavar=metavar.replace("{None,", "{"))


def _of_other_rules(spec_of: Callable[[Any], Any], info: Any) -> Any:
    """What rules but ours make of a type; None while they are asked."""
    if any(info is asked for asked in _asked):
        return None
    _asked.append(info)
    try:
        return spec_of(info)
    finally:
        _asked.pop()


def _flowing_field(field: StructFieldSpec) -> StructFieldSpec:
    kind = without_hint(field.type, field.default)
    return replace(field, type=kind, helptext=_joined_later(field))


def _joined_later(field: StructFieldSpec) -> Callable[[], str | None]:
    def text() -> str | None:
        found = field.helptext() if callable(field.helptext) else field.helptext
        return found and joined(found)

    return text


# --- Rows --------------------------------------------------------------------


def table_or_list(
    rows: Sequence[Mapping[str, Any]], title: str | None, width: int
) -> "Table | Text":
    """Rows as a table without empty columns, or as a list.

    It is a list where a table would break words, or be twice as long. There a row's
    first value heads it.
    Texts may come from strangers: control characters and line breaks are spelled out.

    Args:
        rows: The rows; a key is a column.
        title: Title.
        width: Width of the terminal.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    names = [name for name in rows[0] if any(row[name] is not None for row in rows)]
    lines = [[printable_name(_cell(row[name])) for name in names] for row in rows]
    columns = [[name, *cells] for name, *cells in zip(names, *lines, strict=True)]
    widths = [max(map(len, " ".join(column).split())) for column in columns]
    about = None if title is None else printable_name(title)
    parts = [Text(about)] if about else []
    for name, *cells in lines:
        parts += [Text(name, "bold"), Text(_paragraph(names[1:], cells, width))]
    listed = Text("\n", no_wrap=True, overflow="ignore").join(parts)
    table = Table(title=about and Text(about, "table.title"))
    for name, *cells in columns:
        whole = not any(" " in cell for cell in cells)
        table.add_column(name, overflow="fold", no_wrap=whole)
    for line in lines:
        table.add_row(*map(Text, line))
    fits = sum(widths) + 3 * len(names) + 1 <= width
    height = len(Console(width=width).render_lines(table)) - _FRAME
    return table if fits and height <= 2 * len(listed.split()) else listed


def _paragraph(names: Sequence[str], cells: Sequence[str], width: int) -> str:
    pairs = zip(names, cells, strict=True)
    return textwrap.fill(
        " | ".join(f"{name}: {cell}" for name, cell in pairs if cell),
        width,
        initial_indent="    ",
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def _cell(value: Any) -> str:
    if isinstance(value, Mapping):
        value = [f"{name} {number}" for name, number in value.items()]
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return "-" if value is None else str(value)
