"""marl-mm datasets: lists, cards and checks of datasets, and new ones made of them."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import tyro

from marl_mm.commands.datasets_build import build_named, list_named, rebuild_card
from marl_mm.commands.datasets_make import (
    make_filtered,
    make_imported,
    make_mix,
    make_split,
)
from marl_mm.commands.options import CORES
from marl_mm.commands.output import print_rows, read_dataset, show, warn_if_stopped
from marl_mm.commands.parser import parse_subcommand
from marl_mm.commands.wording import as_options
from marl_mm.datasets.card import card_markdown, card_text, keep_card
from marl_mm.datasets.catalogue import catalogue, check_deletable, delete
from marl_mm.datasets.dataset import existing, load_dataset
from marl_mm.datasets.export import DATASET_FORMS, export
from marl_mm.datasets.location import datasets_root, find, known_ids
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.verify import verify
from marl_mm.errors import DatasetError, UsageError
from marl_mm.progress import progress_bar
from marl_mm.runs.settings import check_positive

_FORMS = " ".join(f"{name}: {form.about}" for name, form in DATASET_FORMS.items())


def _list(*, json: bool = False) -> None:
    """List the datasets below $MINARI_DATASETS_PATH.

    Args:
        json: Print JSON.
    """
    rows = [row | {"note": as_options(row["note"])} for row in catalogue()]
    print_rows(rows, json, f"below {datasets_root()}")
    if not known_ids() and not json:
        print("make one of your own: marl-mm collect pd")


def _show(
    dataset: tyro.conf.Positional[str], *, markdown: bool = False, json: bool = False
) -> None:
    """Show a dataset's card, and keep it with the dataset as JSON, Markdown, figure.

    Args:
        dataset: Id such as marl_mm/reach/pd-v0, or pd for short, or path, or name of
            a named dataset; good-5k ships.
        markdown: Print Markdown.
        json: Print JSON.
    """
    values = keep_card(load_dataset(dataset))
    show(values, card_markdown(values) if markdown else card_text(values), json)


def _verify(
    datasets: tyro.conf.Positional[tuple[str, ...]],
    *,
    replay: bool = False,
    workers: int = CORES,
    json: bool = False,
) -> None:
    """Check a dataset's files: schema, hashes, finiteness, ranges, ends of episodes.

    Args:
        datasets: Ids or paths.
        replay: Run every episode again, too, and compare all bits.
        workers: Processes that replay.
        json: Print JSON.
    """
    check_positive(workers=workers)
    if not datasets:
        raise UsageError("name at least one dataset")
    problems_of: dict[str, list[str]] = {}
    for name in datasets:
        location = existing(name)
        problems = verify(location)
        if not problems and replay:
            try:
                problems = _replayed(name, workers)
            except DatasetError as error:  # imported
                problems = [as_options(str(error))]
        problems_of[name] = problems
        if not problems:
            warn_if_stopped(location, read_metadata(location))
        if not json:
            print(f"{name}: {'; '.join(problems) or 'all is well'}", flush=True)
    if json:
        show(problems_of)
    if any(problems_of.values()):
        broken = [name for name, problems in problems_of.items() if problems]
        raise DatasetError(f"not as they should be: {', '.join(broken)}")


def _replayed(name: str, workers: int) -> list[str]:
    from marl_mm.collectors.replay import problems  # which needs the simulator

    dataset = load_dataset(name)
    with progress_bar("replay", len(dataset.arrays)) as advance:
        return problems(dataset, workers, advance)


def _export(
    dataset: tyro.conf.Positional[str],
    *,
    out: Path,
    layout: Annotated[str, tyro.conf.arg(help=_FORMS)] = "flat",
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Write a dataset as a file or folder that other libraries read.

    Args:
        dataset: Id or path.
        out: File or folder to write.
        layout: Form of what is written.
        overwrite: Replace it if it exists.
        json: Print JSON.
    """
    data = read_dataset(dataset)
    export(data, layout, out, overwrite)
    steps, episodes = data.arrays.steps, len(data.arrays)
    files = [file for file in (out, *out.rglob("*")) if file.is_file()]
    size = sum(file.stat().st_size for file in files)
    result = {
        "file": str(out),
        "layout": layout,
        "steps": steps,
        "episodes": episodes,
        "bytes": size,
    }
    text = f"{out}: {steps} steps, {episodes} episodes, {size / 1e3:,.0f} kB"
    show(result, text, json)


def _delete(
    dataset: tyro.conf.Positional[str], *, yes: bool = False, json: bool = False
) -> None:
    """Delete a dataset, and the kept episodes of a stopped collection into it.

    Args:
        dataset: Id or path.
        yes: Do not ask.
        json: Print JSON.
    """
    location = find(dataset)
    check_deletable(location)
    what, kept = str(location.folder), ""
    if location.folder.is_symlink():
        what = f"the link {what}"
        kept = f"; {location.folder.readlink()}, where it led, is kept"
    if not yes:
        if sys.stdin is None or not sys.stdin.isatty():
            raise UsageError("there is no terminal to confirm on: add --yes to delete")
        try:
            print(f"delete {what}? [y/N] ", end="", file=sys.stderr, flush=True)
            answer = input()
        except EOFError:
            answer = ""
        if answer.strip().lower() not in ("y", "yes"):
            show({"deleted": None}, "kept", json)
            return
    delete(location)
    show({"deleted": str(location.folder)}, f"deleted {what}{kept}", json)


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm datasets``."""
    functions: dict[str, Callable[..., None]] = {
        "list": _list,
        "show": _show,
        "mix": make_mix,
        "split": make_split,
        "filter": make_filtered,
        "verify": _verify,
        "export": _export,
        "import": make_imported,
        "delete": _delete,
        "build": build_named,
        "catalogue": list_named,
        "rebuild": rebuild_card,
    }
    about = "List, show, check datasets; make new ones of them."
    _, call = parse_subcommand(functions, "marl-mm datasets", about, arguments)
    call()
