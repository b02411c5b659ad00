"""The command line: finds a command, runs it, and turns errors into one line."""

import importlib
import os
import signal
import sys
from collections.abc import Sequence

from marl_mm.errors import MarlMmError, UsageError
from marl_mm.interrupts import end_on_signals

COMMANDS = {
    "quickstart": "collect, train and evaluate in a few minutes, with a report",
    "collect": "collect a dataset: pretrained, pd, medium, random, scripted, paper",
    "datasets": "list, show, mix, split, filter, verify, export, import, delete",
    "train": "train a policy: from a dataset, or online",
    "eval": "evaluate runs and scripted policies on fixed goals",
    "export": "a policy as TorchScript or ONNX",
    "play": "film an episode, or watch it in a window",
    "sweep-alpha": "what alpha does: tables and figures over alpha, form and task",
    "ablate": "reproduce figures and tables, training the runs they need",
    "report": "all tables and figures on one page",
    "bench": "measure the controller, and the speed of training and data",
}
"""Each command is a module of ``marl_mm.commands``, imported when it is called."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``marl-mm`` and return its exit code: 0, 1 failure, 2 usage, 130 Ctrl-C."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    end_on_signals()
    try:
        code = _run(words)
        sys.stdout.flush()
        return code
    except MarlMmError as error:
        _complain(str(error))
        return error.exit_code
    except BrokenPipeError:  # the reader has gone; say nothing more, at exit neither
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 0
    except OSError as error:  # disk full, no permission
        _complain(f"{error.strerror or error}: {error.filename or 'standard output'}")
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return MarlMmError.exit_code
    except KeyboardInterrupt as error:
        for number in (signal.SIGINT, signal.SIGTERM):  # it is ending already
            signal.signal(number, signal.SIG_IGN)
        _complain(str(error) or "interrupted")
        return INTERRUPTED


def _run(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help"):
        _print(_usage())
        return 0 if words else 2
    if words[0] == "--version":
        from marl_mm import __version__

        _print(f"marl-mm {__version__}")
        return 0
    if words[0] not in COMMANDS:
        raise UsageError(
            f"unknown command {words[0]!r}, expected one of {', '.join(COMMANDS)}"
        )
    module = words[0].replace("-", "_")
    importlib.import_module(f"marl_mm.commands.{module}").main(words[1:])
    return 0


def _usage() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {text}" for name, text in COMMANDS.items()]
    return (
        "usage: marl-mm COMMAND [OPTIONS]\n\n"
        "Multi-agent reinforcement learning on a mobile manipulator.\n\n"
        + "\n".join(lines)
        + "\n\nmarl-mm COMMAND --help tells a command's options, units and defaults."
    )


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")


def _complain(text: str) -> None:
    sys.stderr.write(f"marl-mm: {text}\n")


if __name__ == "__main__":
    sys.exit(main())
