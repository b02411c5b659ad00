"""marl-mm datasets: lists, cards and checks of datasets, and new ones made of them."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Column, Table

from marl_mm.commands.datasets_make import (
    Filter,
    Import,
    Mix,
    Split,
    make_filtered,
    make_imported,
    make_mix,
    make_split,
)
from marl_mm.commands.options import read_dataset, warn_if_stopped
from marl_mm.commands.parser import parse_subcommand
from marl_mm.commands.wording import as_options
from marl_mm.datasets.card import card, card_markdown, card_text, keep_card
from marl_mm.datasets.catalogue import catalogue, check_deletable, delete
from marl_mm.datasets.dataset import existing, load_dataset
from marl_mm.datasets.export import DATASET_FORMS, export
from marl_mm.datasets.location import datasets_root, find, known_ids
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.verify import verify
from marl_mm.errors import DatasetError, UsageError
from marl_mm.progress import progress_bar
from marl_mm.runs.settings import check_positive
from marl_mm.workers import available_cores

_COUNTS = ("steps", "episodes")


@dataclass(frozen=True, kw_only=True)
class _Printed:
    json: bool = False
    """Print JSON."""


@dataclass(frozen=True, kw_only=True)
class List(_Printed):
    """List the datasets below $MINARI_DATASETS_PATH."""


@dataclass(frozen=True, kw_only=True)
class Show(_Printed):
    """Show a dataset's card, and keep it with the dataset as JSON, Markdown, figure."""

    dataset: tyro.conf.Positional[str]
    """Id such as marl_mm/reach/pd-v0, or pd for short, or path; good-5k ships."""

    markdown: bool = False
    """Print Markdown."""


@dataclass(frozen=True, kw_only=True)
class Verify(_Printed):
    """Check a dataset's files: schema, hashes, finiteness, ranges, ends of episodes."""

    datasets: tyro.conf.Positional[tuple[str, ...]]
    """Ids or paths."""

    replay: bool = False
    """Run every episode again, too, and compare all bits."""

    workers: int = field(default_factory=available_cores)
    """Processes that replay."""


@dataclass(frozen=True, kw_only=True)
class Export(_Printed):
    """Write a dataset as one flat HDF5 file that other libraries read."""

    dataset: tyro.conf.Positional[str]
    """Id or path."""

    out: Path
    """File to write."""

    layout: Annotated[
        str,
        tyro.conf.arg(
            help=" ".join(
                f"{name}: {form.about}" for name, form in DATASET_FORMS.items()
            )
        ),
    ] = "flat"

    overwrite: bool = False
    """Replace the file if it exists."""


@dataclass(frozen=True, kw_only=True)
class Delete(_Printed):
    """Delete a dataset, and the kept episodes of a stopped collection into it."""

    dataset: tyro.conf.Positional[str]
    """Id or path."""

    yes: bool = False
    """Do not ask."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm datasets``."""
    name, command = parse_subcommand(
        {
            "list": List,
            "show": Show,
            "mix": Mix,
            "split": Split,
            "filter": Filter,
            "verify": Verify,
            "export": Export,
            "import": Import,
            "delete": Delete,
        },
        "marl-mm datasets",
        "List, show, check datasets; make new ones of them.",
        arguments,
    )
    commands: dict[str, Any] = {
        "list": _list,
        "show": _show,
        "mix": make_mix,
        "split": make_split,
        "filter": make_filtered,
        "verify": _verify,
        "export": _export,
        "import": make_imported,
        "delete": _delete,
    }
    commands[name](command)


def _list(command: List) -> None:
    rows = [row | {"note": as_options(row["note"])} for row in catalogue()]
    if command.json:
        print(json.dumps(rows, indent=2))
        return
    name = Column("id", overflow="fold")
    table = Table(name, "steps", "episodes", "note", title=f"below {datasets_root()}")
    for row in rows:
        counts = ("-" if row[key] is None else str(row[key]) for key in _COUNTS)
        table.add_row(row["id"], *counts, row["note"])
    console = Console(markup=False)
    if not console.is_terminal:  # whole ids, for a search
        console = Console(width=80 + max(len(row["id"]) for row in rows), markup=False)
    console.print(table)
    if not known_ids():
        print("make one of your own: marl-mm collect pd")


def _show(command: Show) -> None:
    dataset = load_dataset(command.dataset)
    values = keep_card(dataset)
    if command.json:
        print(json.dumps(values, indent=2))
    elif command.markdown:
        print(card_markdown(card(dataset)))
    else:
        print(card_text(values))


def _verify(command: Verify) -> None:
    check_positive(workers=command.workers)
    if not command.datasets:
        raise UsageError("name at least one dataset")
    found = {}
    for name in command.datasets:
        location = existing(name)
        problems = verify(location)
        if not problems and command.replay:
            try:
                problems = _replayed(name, command.workers)
            except DatasetError as error:  # imported
                problems = [as_options(str(error))]
        found[name] = problems
        if not problems:
            warn_if_stopped(location, read_metadata(location))
        if not command.json:
            print(f"{name}: {'; '.join(problems) or 'all is well'}", flush=True)
    if command.json:
        print(json.dumps(found, indent=2))
    if any(found.values()):
        broken = [name for name, problems in found.items() if problems]
        raise DatasetError(f"not as they should be: {', '.join(broken)}")


def _replayed(name: str, workers: int) -> list[str]:
    from marl_mm.collectors.replay import problems  # which needs the simulator

    dataset = load_dataset(name)
    with progress_bar("replay", len(dataset.arrays)) as advance:
        return problems(dataset, workers, advance)


def _export(command: Export) -> None:
    dataset = read_dataset(command.dataset)
    export(dataset, command.layout, command.out, command.overwrite)
    size = command.out.stat().st_size
    result = {
        "file": str(command.out),
        "layout": command.layout,
        "steps": dataset.arrays.steps,
        "episodes": len(dataset.arrays),
        "bytes": size,
    }
    if command.json:
        print(json.dumps(result, indent=2))
    else:
        print(
            f"{command.out}: {result['steps']} steps, {result['episodes']} episodes, "
            f"{size / 1e3:,.0f} kB"
        )


def _delete(command: Delete) -> None:
    location = find(command.dataset)
    check_deletable(location)
    target = location.folder.readlink() if location.folder.is_symlink() else None
    what = location.folder if target is None else f"the link {location.folder}"
    if not command.yes:
        if not sys.stdin.isatty():
            raise UsageError("nobody is here to answer: add --yes to delete")
        try:
            answer = input(f"delete {what}? [y/N] ")
        except EOFError:
            answer = ""
        if answer.strip().lower() not in ("y", "yes"):
            print(json.dumps({"deleted": None}) if command.json else "kept")
            return
    delete(location)
    if command.json:
        print(json.dumps({"deleted": str(location.folder)}))
    else:
        kept = "" if target is None else f"; {target}, where it led, is kept"
        print(f"deleted {what}{kept}")
