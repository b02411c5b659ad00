"""Messages of the package in the words of the command line: parameters are options."""

import re

_PARAMETER = re.compile(r"`([a-z]\w*)(=True|=False)?`")

_CALLS = {
    "`start`": "--from",
    "`marl_mm.plugins.load(...)`": "--plugin",
    "`marl_mm.collect(..., resume=True)`": "marl-mm collect ... --resume",
}
"""Calls, and how the command line words them."""


def as_options(text: str) -> str:
    """A message with its parameters in backquotes spelled as options.

    "`resume=True`" becomes "--resume", "`resume=False`" becomes "--no-resume" and
    "`max_steps`" becomes "--max-steps".
    """
    for call, words in _CALLS.items():
        text = text.replace(call, words)
    return _PARAMETER.sub(_option, text)


def _option(match: re.Match[str]) -> str:
    name, value = match.groups()
    return f"--{'no-' * (value == '=False')}{name.replace('_', '-')}"
