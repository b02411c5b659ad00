"""marl-mm --print-completion bash: a script that completes commands and options.

tyro knows each command's own options; the script is made of what it says of them.
"""

import ast
import importlib
import io
import re
from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout, suppress
from typing import Any

from marl_mm.cli import COMMANDS, COMPLETION, LISTS, PLUGIN

_SCRIPT = """\
# Completion of marl-mm, printed by marl-mm --print-completion bash.
_marl_mm() {
  local current=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]}
  local command="" word choices
  local -A words=(
%s
  )
  for word in "${COMP_WORDS[@]:1:COMP_CWORD-1}"; do
    [[ $word != -* && ${words["marl-mm$command $word"]+known} ]] && command+=" $word"
  done
  choices=${words["marl-mm$command"]}
  [[ ${words["marl-mm$command $before"]+known} ]] &&
    choices=${words["marl-mm$command $before"]}
  COMPREPLY=($(compgen -W "$choices" -- "$current"))
}
complete -o default -F _marl_mm marl-mm
"""
"""Files are completed where nothing else is (``-o default``)."""


def script() -> str:
    """The script; it names what is registered, plug-ins' things too."""
    top = (*COMMANDS, *LISTS, "--help", "--version", PLUGIN, COMPLETION)
    table = {"marl-mm": top, f"marl-mm {COMPLETION}": ("bash",)}
    for name in (*COMMANDS, *LISTS):
        table |= _table(f"marl-mm {name}", _spec(name))
    lines = (f'    ["{key}"]="{" ".join(words)}"' for key, words in table.items())
    return _SCRIPT % "\n".join(lines)


def _spec(name: str) -> Mapping[str, Any]:
    """What tyro's own script for one command says of options and subcommands."""
    module = "listing" if name in LISTS else name.replace("-", "_")
    words = [name] if name in LISTS else []
    printed = io.StringIO()
    with redirect_stdout(printed), suppress(SystemExit):
        main = importlib.import_module(f"marl_mm.commands.{module}").main
        main([*words, "--tyro-print-completion", "bash"])
    match = re.search("^COMPLETION_SPEC = (.*)$", printed.getvalue(), re.MULTILINE)
    assert match, printed.getvalue()
    spec: Mapping[str, Any] = ast.literal_eval(match[1])
    return spec


def _table(command: str, spec: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """Words that may follow a command, its subcommands and its options with choices."""
    table = {command: (*spec["subcommands"], *_flags(spec), PLUGIN)}
    for option in spec["options"]:
        if option.get("choices"):
            choices = tuple(sorted(option["choices"]))  # of a set
            table |= {f"{command} {flag}": choices for flag in option["flags"]}
    for name, inner in spec["subcommands"].items():
        table |= _table(f"{command} {name}", inner)
    return table


def _flags(spec: Mapping[str, Any]) -> Iterator[str]:
    for option in spec["options"]:
        yield from (flag for flag in option["flags"] if flag.startswith("--"))
