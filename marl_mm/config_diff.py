"""Comparison of the config that a folder was begun with and the one of now."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from marl_mm.errors import OtherConfigError

_LISTED = 6
"""Largest number of differing values that a message lists."""


_ADVICE = (
    "go on with the same, or start anew in another folder or with `overwrite=True`"
)
"""Default advice on a config mismatch."""


def refuse_other_config(
    folder: Path, begun: dict[str, Any], current: dict[str, Any], advice: str = _ADVICE
) -> None:
    """Raise if a folder was begun with other values than those that continue it.

    Args:
        folder: The folder.
        begun: The config it was begun with, JSON-serialisable.
        current: The config of now; keys that only ``begun`` has are ignored.
        advice: Advice that the error ends with.

    Raises:
        OtherConfigError: Listing the values that differ.
    """
    differing = list(changes(as_json(begun), as_json(current)))
    if len(differing) > _LISTED:
        differing[_LISTED:] = [f"{len(differing) - _LISTED} more"]
    if differing:
        raise OtherConfigError(f"{folder} was made with {', '.join(differing)}", advice)


def changes(
    begun: dict[str, Any], current: dict[str, Any], path: str = ""
) -> Iterator[str]:
    """Values of two configs that differ, in words; keys of ``begun`` alone do not.

    Args:
        begun: The former config.
        current: The config of now.
        path: Beginning of the values' names.
    """
    for key, value in current.items():
        before = begun.get(key)
        if isinstance(value, dict) and isinstance(before, dict):
            yield from changes(before, value, f"{path}{key}.")
        elif before != value:
            yield f"{path}{key} = {_short(before)} (now {_short(value)})"


def _short(value: Any) -> str:
    return f"{{{len(value)} values}}" if isinstance(value, dict) else str(value)


def as_json(values: dict[str, Any]) -> dict[str, Any]:
    """Values as JSON returns them: tuples become lists."""
    returned: dict[str, Any] = json.loads(json.dumps(values))
    return returned
