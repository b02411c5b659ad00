"""Options from dataclasses, through tyro, with its complaints brought to one line."""

import io
import re
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from typing import Any, TypeVar

import tyro

from marl_mm.errors import UsageError

T = TypeVar("T")


def parse_options(options: type[T], prog: str, arguments: Sequence[str]) -> T:
    """One command's options.

    Raises:
        UsageError: If the arguments are not the options' own.
    """
    return _in_one_line(lambda: tyro.cli(options, prog=prog, args=arguments), prog)


def parse_subcommand(
    commands: dict[str, Callable[..., Any]],
    prog: str,
    description: str,
    arguments: Sequence[str],
) -> Any:
    """The options of whichever subcommand the arguments name.

    Raises:
        UsageError: If they name none, or are not its options.
    """
    return _in_one_line(
        lambda: tyro.extras.subcommand_cli_from_dict(
            commands, prog=prog, description=description, args=arguments
        ),
        prog,
    )


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
