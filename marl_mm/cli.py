"""The command line: finds a command, runs it, and turns errors into one line."""

import errno
import importlib
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress

from marl_mm.commands.wording import as_options
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.interrupts import end_on_signals
from marl_mm.received import printable
from marl_mm.words import check_words

COMMANDS = {
    "quickstart": "collect, train and evaluate in a few minutes, with a report",
    "collect": "collect a dataset with a scripted or a learnt policy",
    "datasets": "catalogue, build, list, show, verify, mix, export, import and more",
    "cache": "show or clear what was derived from datasets",
    "train": "train a policy: from a dataset, or online",
    "runs": "list runs with their scores",
    "eval": "evaluate runs and scripted policies on fixed goals",
    "export": "a policy as TorchScript or ONNX",
    "play": "film an episode, or watch it in a window",
    "sweep-alpha": "what alpha does: tables and figures over alpha, form and task",
    "ablate": "reproduce figures and tables, training the runs they need",
    "report": "all tables and figures on one page",
    "submit": "runs as a folder that anybody can score again",
    "verify": "score a submission again: equal to the bit, within intervals, or not",
    "board": "submissions side by side on a page, with tie groups",
    "bench": "measure the controller, and the speed of training and data",
    "check": "whether a plug-in keeps its promises; whether files are whole and safe",
}
"""Each command is a module of ``marl_mm.commands``, imported when it is called."""

LISTS = ("algorithms", "tasks", "collectors", "formats", "metrics")
"""Commands that list the registered objects of a kind, and their origins."""

PLUGIN = "--plugin"
"""Option of every command; its values are Python files or modules."""

ABOUT_PLUGINS = (
    f"Every command takes {PLUGIN} FILE.py|MODULE, any number of times: a plug-in\n"
    "with tasks, algorithms or collectors of your own. It is code and is run as such:\n"
    "name only what you trust. Nothing in a dataset or a run ever loads one."
)

COMPLETION = "--print-completion"
"""Option that prints a script for a shell."""

ABOUT_COMPLETION = (
    f"Completion in bash: marl-mm {COMPLETION} bash >\n"
    "~/.local/share/bash-completion/completions/marl-mm"
)

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""

_CIRCLE = "Symlink loop"
"""Words of an error about links that lead to each other."""

_UNWRITTEN = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
"""Errors of writing to an open file."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``marl-mm`` and return its exit code: 0, 1 failure, 2 usage, 130 Ctrl-C."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    end_on_signals()
    for name in ("stdout", "stderr"):  # which may be closed, as for a daemon's child
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
        with suppress(AttributeError):  # of what a program put in its place
            getattr(sys, name).reconfigure(errors="backslashreplace")
    try:
        code = _run(words)
        sys.stdout.flush()
        return code
    except MarlMmError as error:
        _complain(str(error))
        return error.exit_code
    except BrokenPipeError:  # the reader has gone; keep silent, also at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return MarlMmError.exit_code  # what was left to do is not done
    except (MemoryError, RuntimeError) as error:
        if _CIRCLE in str(error):  # before Python 3.13
            _complain(str(error))
            return MarlMmError.exit_code
        if not _is_memory(error):
            raise
        _complain("there is not enough memory for that: ask for less at a time")
        return MarlMmError.exit_code
    except OSError as error:  # disk full, no permission
        _complain(_in_words(error))
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return MarlMmError.exit_code
    except KeyboardInterrupt as error:
        for number in (signal.SIGINT, signal.SIGTERM):  # it is ending already
            signal.signal(number, signal.SIG_IGN)
        _complain(str(error) or "interrupted")
        return INTERRUPTED


def _run(words: list[str]) -> int:
    check_words(words)
    if not words or words[0] in ("-h", "--help"):
        _print(_usage())
        return 0 if words else 2
    if words[0] == "--version":
        from marl_mm import __version__

        _print(f"marl-mm {__version__}")
        return 0
    words, sources = _without_plugins(words)
    if words[:1] in (["-h"], ["--help"], ["--version"]):
        return _run(words[:1])
    if words[:1] and words[0] not in (*COMMANDS, *LISTS, COMPLETION):
        choices = ", ".join((*COMMANDS, *LISTS))
        raise UsageError(f"unknown command {words[0]!r}, expected one of {choices}")
    if sources:
        from marl_mm.plugins import load_all

        load_all(sources)
    if not words:
        raise UsageError(f"{PLUGIN} needs a command, such as marl-mm tasks")
    if words[0] == COMPLETION:
        from marl_mm.commands.completion import script

        if words[1:] != ["bash"]:
            raise UsageError(f"{COMPLETION} is {' '.join(words[1:])!r}, expected bash")
        _print(script())
        return 0
    if words[0] in LISTS:
        words = ["listing", *words]
    module = words[0].replace("-", "_")
    importlib.import_module(f"marl_mm.commands.{module}").main(words[1:])
    return 0


def _without_plugins(words: list[str]) -> tuple[list[str], list[str]]:
    """The words without ``--plugin``, wherever it stands, and its values.

    Raises:
        UsageError: If it has no value.
    """
    rest, sources = [], []
    remaining = iter(words)
    for word in remaining:
        if word == PLUGIN:
            sources.append(next(remaining, ""))
        elif word.startswith(f"{PLUGIN}="):
            sources.append(word.removeprefix(f"{PLUGIN}="))
        else:
            rest.append(word)
    if "" in sources or any(source.startswith("--") for source in sources):
        raise UsageError(f"{PLUGIN} has no value, expected FILE.py or a module")
    return rest, sources


def _usage() -> str:
    lists = f"list what is registered: {', '.join(LISTS[1:])} likewise"
    commands = COMMANDS | {LISTS[0]: lists}
    width = max(map(len, commands))
    lines = [f"  {name:<{width}}  {text}" for name, text in commands.items()]
    return (
        "usage: marl-mm COMMAND [OPTIONS]\n\n"
        "Multi-agent reinforcement learning on a mobile manipulator.\n\n"
        + "\n".join(lines)
        + "\n\nmarl-mm COMMAND --help shows a command's options, units and defaults."
        + f"\n\n{ABOUT_PLUGINS}\n\n{ABOUT_COMPLETION}"
    )


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")


def _is_memory(error: Exception) -> bool:
    """Whether memory was short; torch says so in words."""
    return isinstance(error, MemoryError) or any(
        words in str(error) for words in ("allocate memory", "out of memory")
    )


def _in_words(error: OSError) -> str:
    """What the operating system refused, and where: files that we write have names."""
    where = error.filename
    if where is None and error.errno in _UNWRITTEN:
        where = "standard output"
    return f"{error.strerror or error}" + (f": {where}" if where else "")


def _complain(text: str) -> None:
    with suppress(OSError):  # the exit code tells, too
        sys.stderr.write(f"marl-mm: {printable(as_options(text))}\n")
        sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
