"""marl-mm datasets: what there is, and what is in it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from marl_mm.commands.parser import parse_subcommand
from marl_mm.datasets.card import card
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import datasets_root, known_ids, locate
from marl_mm.datasets.storage import read_metadata
from marl_mm.errors import DatasetError


@dataclass(frozen=True)
class List:
    """List the datasets below $MINARI_DATASETS_PATH."""

    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class Show:
    """Show a dataset's card."""

    dataset: tyro.conf.Positional[str]
    """Id, such as marl_mm/reach/pd-v0, or path."""

    json: bool = False
    """Print JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm datasets``."""
    _, command = parse_subcommand(
        {"list": List, "show": Show},
        "marl-mm datasets",
        "List datasets and show what is in them.",
        arguments,
    )
    if isinstance(command, List):
        _list(command)
    else:
        _show(command)


def _list(command: List) -> None:
    rows = [_entry(name) for name in known_ids()]
    if command.json:
        print(json.dumps(rows, indent=2))
        return
    if not rows:
        print(f"no datasets below {datasets_root()}; make one: marl-mm collect pd")
        return
    table = Table("id", "steps", "episodes", "note")
    for row in rows:
        table.add_row(row["id"], str(row["steps"]), str(row["episodes"]), row["note"])
    Console().print(table)


def _entry(name: str) -> dict[str, Any]:
    try:
        metadata = read_metadata(locate(name))
    except DatasetError as error:
        return {"id": name, "steps": None, "episodes": None, "note": str(error)}
    return {
        "id": name,
        "steps": metadata["total_steps"],
        "episodes": metadata["total_episodes"],
        "note": "" if metadata["marl_mm"].get("complete") else "interrupted",
    }


def _show(command: Show) -> None:
    values = card(load_dataset(command.dataset))
    if command.json:
        print(json.dumps(values, indent=2))
        return
    table = Table(show_header=False)
    for key, value in values.items():
        table.add_row(key.replace("_", " "), _text(value))
    Console().print(table)


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return "  ".join(f"{key}: {_text(item)}" for key, item in value.items())
    if isinstance(value, float):
        return f"{value:.3g}"
    return str(value)
