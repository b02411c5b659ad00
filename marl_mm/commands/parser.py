"""Commands from functions and dataclasses, through tyro; its complaints in one line."""

import inspect
import io
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import fields, is_dataclass
from functools import partial
from itertools import pairwise
from typing import Annotated, Any, NamedTuple, Union

import tyro

from marl_mm.cli import ABOUT_PLUGINS
from marl_mm.declared import refuse_taken
from marl_mm.errors import UsageError, meant
from marl_mm.terminal import FLOWING, filled, joined, without_hint

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
    call.__annotations__ = function.__annotations__ | {
        each.name: without_hint(each.annotation, each.default) for each in parameters
    }
    call.__doc__ = joined(inspect.getdoc(function) or "", 8)
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
    if word and word not in (*commands, "-h", "--help", "--tyro-print-completion"):
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
    about = filled(f"{about}\n\n{ABOUT_PLUGINS}")
    described: Any = {"prog": prog, "description": about, "registry": FLOWING} | default
    complaint, columns = io.StringIO(), os.environ.get("COLUMNS", "")
    try:
        if not {"-h", "--help"} & {*arguments}:
            os.environ["COLUMNS"] = "9999"  # so that no word is broken
        with redirect_stderr(complaint):
            return tyro.cli(kind, args=arguments, **described)
    except SystemExit as end:
        if not end.code:  # --help
            raise
        text = _in_a_line(complaint.getvalue(), arguments).rstrip(".")
        raise UsageError(f"{text}; see {prog} --help") from None
    finally:
        os.environ["COLUMNS"] = columns  # empty is as none


def _in_a_line(box: str, arguments: Sequence[str]) -> str:
    """What tyro complains of in a box, drawn in whatever the stream takes."""
    lines = [line.strip("│| ") for line in box.splitlines()[1:-1]]
    sections = re.split(r"\n?[─-]{5,}\n?", "\n".join(lines))
    text = next(text for part in sections if (text := " ".join(part.split())))
    if (unknown := text.removeprefix("Unrecognized options: ")) != text:
        words = (w for w in arguments if unknown.startswith(w))
        word = max(words, key=len, default=unknown)  # of --flag=3 it is the 3
        near = re.findall(r"^.? {4,5}(--[\w.-]+)", box, re.MULTILINE)
        return f"unexpected {word}{meant(word.split('=')[0], near, 0.01)}"
    if odd := re.match(r"(?:Error pars|invalid choice .* arg)\w+ '?(--[\w.-]+)", text):
        option, names = odd[1], [w.split("=")[0].replace("_", "-") for w in arguments]
        begin = max((i for i, name in enumerate(names) if name == option), default=0)
        given = f"{' '.join(arguments[begin:])} --"[len(option) + 1 :].split(" --")[0]
        kind = re.search(rf"^.? +{option} (.+?)[ │|]*$", box, re.MULTILINE)
        expected = kind[1] if kind else ""
        expected = re.sub(r"^\{([^{}]*)\}$", r"\1", expected)
        if choices := re.search(r"Expected one of \((.*)\)", text):
            taken = {*re.findall(r"'(.*?)'", choices[1])} - {"None"}
            expected = f"one of {', '.join(sorted(taken))}"
        return f"{option} is {given!r}, expected {expected}"
    return text
