"""Options from dataclasses, through tyro, with its complaints brought to one line."""

import difflib
import io
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import fields, is_dataclass
from itertools import pairwise
from typing import Annotated, Any, NamedTuple, TypeVar, Union

import tyro

from marl_mm.cli import ABOUT_PLUGINS
from marl_mm.declared import refuse_taken
from marl_mm.errors import UsageError

T = TypeVar("T")


def parse_options(options: type[T], prog: str, arguments: Sequence[str]) -> T:
    """One command's options.

    Raises:
        UsageError: If the arguments are not the options' own.
    """
    description = f"{options.__doc__ or ''}\n\n{ABOUT_PLUGINS}"

    def parse() -> T:
        return tyro.cli(options, prog=prog, description=description, args=arguments)

    return _in_one_line(parse, prog)


class Subcommand(NamedTuple):
    """A subcommand whose options have other defaults than their class."""

    default: Any
    """Default options."""

    description: str
    """Description in the help."""

    kind: Any = None
    """Type of the options, where their class is generic; None: their class."""


def parse_subcommand(
    commands: Mapping[str, type | Subcommand],
    prog: str,
    description: str,
    arguments: Sequence[str],
) -> tuple[str, Any]:
    """The subcommand that the arguments name, and its options.

    Args:
        commands: Dataclasses of options by name.
        prog: Name of the command.
        description: Description of all subcommands together.
        arguments: Command line after ``prog``.

    Raises:
        UsageError: If they name none, or are not its options.
    """
    word = arguments[0] if arguments else ""
    if word and not word.startswith("-") and word not in commands:
        close = difflib.get_close_matches(word, commands, 1)
        hint = f"; did you mean {close[0]}?" if close else "."
        raise UsageError(
            f"{prog} knows no {word!r}, expected one of {', '.join(commands)}{hint} "
            "What a plug-in adds needs --plugin"
        )
    kinds = [_kind(name, command) for name, command in commands.items()]
    union: Any = Union[tuple(kinds)]  # noqa: UP007

    def parse() -> Any:
        about = f"{description}\n\n{ABOUT_PLUGINS}"
        return tyro.cli(union, prog=prog, description=about, args=arguments)

    known = arguments and arguments[0] in commands
    options = _in_one_line(parse, f"{prog} {arguments[0]}" if known else prog)
    return arguments[0], options


def value_of(arguments: Sequence[str], option: str, default: str) -> str:
    """An option's value, before all options are parsed."""
    value = default
    for word, following in pairwise([*arguments, ""]):
        if word == option:
            value = following
        elif word.startswith(f"{option}="):
            value = word.removeprefix(f"{option}=")
    return value


def _kind(name: str, command: type | Subcommand) -> Any:
    if isinstance(command, type):
        return Annotated[command, tyro.conf.subcommand(name)]
    _refuse_clashes(command.default)
    about = tyro.conf.subcommand(
        name, default=command.default, description=command.description
    )
    return Annotated[command.kind or type(command.default), about]


def _refuse_clashes(options: Any) -> None:
    """Raise if settings that stand among a command's options have one's name.

    Raises:
        UsageError: Naming the setting.
    """
    taken: list[str] = []
    for option in fields(options):
        value = getattr(options, option.name)
        names = [option.name]
        if is_dataclass(value) and not isinstance(value, type):
            names = [inner.name for inner in fields(value)]
            refuse_taken(type(value), names, taken)
        taken += names


def _in_one_line(parse: Callable[[], T], prog: str) -> T:
    complaint = io.StringIO()
    try:
        with redirect_stderr(complaint):
            return parse()
    except SystemExit as end:
        if not end.code:  # --help
            raise
        text = _summary(complaint.getvalue())
        raise UsageError(f"{text}; see {prog} --help") from None


def _summary(box: str) -> str:
    """The first section of tyro's box, and its suggestions, without the frame.

    The frame is drawn in whatever characters the stream takes.
    """
    lines = [line.strip("│| ") for line in box.splitlines()[1:-1]]
    sections = re.split(r"\n?[─-]{5,}\n?", "\n".join(lines))
    texts = [text for text in (" ".join(part.split()) for part in sections) if text]
    kept = texts[:1]
    for text in texts[1:]:
        if text.startswith(("Perhaps you meant", "Available subcommands")):
            kept.append(re.split(r" (?=[A-Z][a-z]+ \w+ \w)", text, maxsplit=1)[0])
    return "; ".join(kept)
