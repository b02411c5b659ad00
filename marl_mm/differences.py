"""Whether what is to be resumed was begun with the same config."""

import json
from pathlib import Path
from typing import Any

from marl_mm.errors import OtherConfigError


def refuse_difference(what: Path, theirs: dict[str, Any], mine: dict[str, Any]) -> None:
    """Raise if something was begun with other values than those that go on with it.

    Args:
        what: The folder.
        theirs: With what it was begun, JSON-serialisable.
        mine: What is to go on; keys that are only in theirs do not matter.

    Raises:
        OtherConfigError: Naming what differs.
    """
    theirs, mine = as_json(theirs), as_json(mine)
    differences = [
        f"{key} = {theirs.get(key)} (now {value})"
        for key, value in mine.items()
        if theirs.get(key) != value
    ]
    if differences:
        raise OtherConfigError(
            f"{what} was made with {', '.join(differences)}: go on with the same, or "
            "start anew in another folder or with --overwrite"
        )


def as_json(values: dict[str, Any]) -> dict[str, Any]:
    """As JSON gives it back: tuples are lists."""
    same: dict[str, Any] = json.loads(json.dumps(values))
    return same
