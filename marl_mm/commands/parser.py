"""Commands from functions and dataclasses, through tyro; its complaints in one line."""

import inspect
import io
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import fields, is_dataclass
from functools import partial, wraps
from itertools import pairwise
from typing import Annotated, Any, NamedTuple, TypeVar, Union

import tyro

from marl_mm.cli import ABOUT_PLUGINS
from marl_mm.declared import refuse_taken
from marl_mm.errors import UsageError, meant

T = TypeVar("T")

Main = Callable[[Sequence[str]], None]
"""A command: a function of the words after its name."""


def command(function: Callable[..., None]) -> Main:
    """The command ``marl-mm MODULE`` whose options are a function's parameters.

    Options with defaults of functions have what these return when they are parsed.
    """
    module = function.__module__.rpartition(".")[2]
    return partial(run, function, f"marl-mm {module.replace('_', '-')}")


def run(function: Callable[..., None], prog: str, arguments: Sequence[str]) -> None:
    """Call a function with options for its parameters.

    Args:
        function: Function; its docstring is the help.
        prog: Name of the command.
        arguments: Command line after ``prog``.

    Raises:
        UsageError: If the arguments are not the function's.
    """
    call, about, _ = _kind(function)
    _parse(call, prog, about, arguments)()


def _to_call(function: Callable[..., None]) -> Callable[..., Callable[[], None]]:
    """A function of the same parameters that returns the call instead of making it."""

    @wraps(function)
    def call(*arguments: Any, **options: Any) -> Callable[[], None]:
        return partial(function, *arguments, **options)

    signature = inspect.signature(function)
    parameters = [
        parameter.replace(default=parameter.default())
        if inspect.isfunction(parameter.default)
        else parameter
        for parameter in signature.parameters.values()
    ]
    call.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return call


class Subcommand(NamedTuple):
    """A subcommand whose options have other defaults than their class."""

    default: Any
    """Default options."""

    description: str
    """Description in the help."""


def parse_subcommand(
    commands: Mapping[str, Callable[..., Any] | Subcommand],
    prog: str,
    description: str,
    arguments: Sequence[str],
) -> tuple[str, Any]:
    """The subcommand that the arguments name, and its options.

    Args:
        commands: Dataclasses of options by name, or functions of them: of a function
            the call that is to be made is returned.
        prog: Name of the command.
        description: Description of all subcommands together.
        arguments: Command line after ``prog``.

    Raises:
        UsageError: If they name none, or are not its options.
    """
    word = arguments[0] if arguments else ""
    if word and not word.startswith("-") and word not in commands:
        raise UsageError(
            f"{prog} knows no {word!r}{meant(word, commands)}, expected one of "
            f"{', '.join(commands)}. What a plug-in adds needs --plugin"
        )
    if word in commands:  # alone: what it complains of, and hints at, is its own
        kind, about, default = _kind(commands[word])
        return word, _parse(kind, f"{prog} {word}", about, arguments[1:], **default)
    kinds: list[Any] = []
    for name, command in commands.items():
        kind, about, default = _kind(command)
        named = tyro.conf.subcommand(name, description=about, **default)
        kinds.append(Annotated[kind, named])
    union: Any = Union[tuple(kinds)]  # noqa: UP007
    return word, _parse(union, prog, description, arguments)


def value_of(arguments: Sequence[str], option: str, default: str) -> str:
    """An option's value, before all options are parsed."""
    value = default
    for word, following in pairwise([*arguments, ""]):
        if word == option:
            value = following
        elif word.startswith(f"{option}="):
            value = word.removeprefix(f"{option}=")
    return value


def _kind(kind: Callable[..., Any] | Subcommand) -> tuple[Any, str, dict[str, Any]]:
    """What tyro makes of options, its description, and its default if it has one."""
    if isinstance(kind, Subcommand):
        _refuse_clashes(kind.default)
        return type(kind.default), kind.description, {"default": kind.default}
    about = inspect.cleandoc(kind.__doc__ or "").partition("\n\nArgs:")[0]
    return _to_call(kind) if inspect.isfunction(kind) else kind, about, {}


def _refuse_clashes(options: Any) -> None:
    """Raise a UsageError that names a setting that has the name of another option."""
    taken: list[str] = []
    for option in fields(options):
        value = getattr(options, option.name)
        names = [option.name]
        if is_dataclass(value) and not isinstance(value, type):
            names = [inner.name for inner in fields(value)]
            refuse_taken(type(value), names, taken)
        taken += names


def _parse(
    kind: Any, prog: str, about: str, arguments: Sequence[str], **default: Any
) -> Any:
    """Options of a kind."""
    complaint = io.StringIO()
    described = {"prog": prog, "description": f"{about}\n\n{ABOUT_PLUGINS}"} | default
    try:
        with redirect_stderr(complaint):
            return tyro.cli(kind, args=arguments, **described)
    except SystemExit as end:
        if not end.code:  # --help
            raise
        text = _summary(complaint.getvalue())
        raise UsageError(f"{text.rstrip('.')}; see {prog} --help") from None


def _summary(box: str) -> str:
    """What tyro complains of, in a line, without the frame.

    The frame is drawn in whatever characters the stream takes.
    """
    lines = "\n".join(line.strip("│| ") for line in box.splitlines()[1:-1])
    sections = re.split(r"\n?[─-]{5,}\n?", lines)
    text = next(text for part in sections if (text := " ".join(part.split())))
    if unknown := re.match(r"Unrecognized options: ([^\s,]+)", text):
        word = unknown[1]
        near = re.findall(r"^.? {4,5}(--[\w.-]+)", box, re.MULTILINE)
        return f"unexpected {word}{meant(word, near, 0.01)}"
    if odd := re.match(r"Error parsing (\S+): .*?\[?('[^'\]]*'(?:, '[^']*')*)", text):
        option, value = odd.groups()
        kind = re.search(rf"^.? +{option} (.+?)[ │|]*$", box, re.MULTILINE)
        expected = kind[1].removeprefix("{None}|").strip("{}") if kind else "another"
        return f"{option} is {value}, expected {expected}"
    if odd := re.match(r"invalid choice ('.*') for argument '(\S+)'.*\((.*)\)", text):
        value, option, choices = odd.groups()
        names = sorted({*re.findall(r"'([^']*)'", choices)} - {"None"})
        return f"{option} is {value}, expected one of {', '.join(names)}"
    return text
