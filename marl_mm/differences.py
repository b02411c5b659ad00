"""Whether what is to be resumed was begun with the same config."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from marl_mm.errors import OtherConfigError

_NAMED = 6
"""Differences that a message names."""


def refuse_difference(what: Path, theirs: dict[str, Any], mine: dict[str, Any]) -> None:
    """Raise if something was begun with other values than those that go on with it.

    Args:
        what: The folder.
        theirs: With what it was begun, JSON-serialisable.
        mine: What is to go on; keys that are only in theirs do not matter.

    Raises:
        OtherConfigError: Naming what differs.
    """
    differences = list(_different(as_json(theirs), as_json(mine)))
    if len(differences) > _NAMED:
        differences[_NAMED:] = [f"{len(differences) - _NAMED} more"]
    if differences:
        raise OtherConfigError(
            f"{what} was made with {', '.join(differences)}",
            "go on with the same, or start anew in another folder or with --overwrite",
        )


def _different(
    theirs: dict[str, Any], mine: dict[str, Any], path: str = ""
) -> Iterator[str]:
    for key, value in mine.items():
        before = theirs.get(key)
        if isinstance(value, dict) and isinstance(before, dict):
            yield from _different(before, value, f"{path}{key}.")
        elif before != value:
            yield f"{path}{key} = {_short(before)} (now {_short(value)})"


def _short(value: Any) -> str:
    return f"{{{len(value)} values}}" if isinstance(value, dict) else str(value)


def as_json(values: dict[str, Any]) -> dict[str, Any]:
    """As JSON gives it back: tuples are lists."""
    same: dict[str, Any] = json.loads(json.dumps(values))
    return same
