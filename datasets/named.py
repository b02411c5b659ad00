"""Names of the named datasets: what is on record of them, and the ids they stand for.

``marl_mm.runs.recipes`` has what they are made of, which readers of data need not know.
"""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

RECORD = Path(__file__).with_name("recipes.json")
"""File of what the recipes gave, by name."""

AXES: Mapping[str, str] = MappingProxyType(
    {
        "expert": "the script, and only what reaches the goal",
        "noisy": "the script with noise, successes and failures",
        "explore": "much slow noise: 5 to 10 % reach the goal by chance",
        "rare": "noise that leaves 2 to 5 % of the episodes to reach the goal",
        "one-bad": "one agent of the team acts at random, another one in each episode",
        "conventions": "each episode by one of the task's conventions",
        "stitch": "the script on one half of the way in each episode",
        "narrow": "the script on the easy level only",
    }
)
"""What the data of each kind are, by its name; a study chooses what it tests on."""


@cache
def named_ids() -> Mapping[str, str]:
    """Ids of the named datasets on record, by name."""
    return MappingProxyType(
        {name: _id(name) for name in json.loads(RECORD.read_text("utf-8"))}
    )


def name_of(dataset_id: str) -> str | None:
    """Name of the named dataset that has an id; None of others."""
    names = (name for name, other in named_ids().items() if other == dataset_id)
    return next(names, None)


def _id(name: str) -> str:
    kind = next(axis for axis in AXES if name.endswith(f"-{axis}"))
    return f"marl_mm/{name.removesuffix(f'-{kind}')}/{kind}-v0"
