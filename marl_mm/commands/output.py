"""Output that several commands share."""

import json
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from marl_mm.datasets.location import Location
from marl_mm.received import printable_name
from marl_mm.terminal import table_or_list

if TYPE_CHECKING:  # a help takes neither data nor the simulator
    from marl_mm.datasets.dataset import Dataset
    from marl_mm.eval.evaluate import Evaluation


def show(values: Any, text: str = "", as_json: bool = True) -> None:
    """Print values as JSON, or a text about them."""
    print(json.dumps(values, indent=2) if as_json else text)


def print_rows(
    rows: Sequence[Mapping[str, Any]], as_json: bool, title: str | None = None
) -> None:
    """Print rows as JSON or, a column a key, as a table or list, ``table_or_list``.

    Into a pipe, texts of the table are whole, for a search.
    """
    from rich.console import Console

    if as_json:
        show(rows)
        return
    console = Console()
    console = console if console.is_terminal else Console(width=200)
    console.print(table_or_list(rows, title, console.width))


def print_evaluations(evaluations: Sequence["Evaluation"]) -> None:
    """Print a table of evaluations; into a pipe, with names in full."""
    from rich.console import Console

    from marl_mm.eval.metrics import failures_in_words
    from marl_mm.eval.tables import evaluation_table

    console = Console(markup=False)
    if not console.is_terminal:
        console = Console(width=1_000, markup=False)
    console.print(evaluation_table(evaluations, console.width))
    for evaluation in evaluations:
        failures = evaluation.summary["all"].get("failures")
        if failures is not None:
            name = printable_name(evaluation.policy)
            print(f"{name} failed: {failures_in_words(failures)}")


def read_dataset(name: str | Location) -> "Dataset":
    """A dataset, with a line on stderr if its collection was stopped.

    Raises:
        UnknownDatasetError: If there is none.
        DatasetError: If its files are damaged.
    """
    from marl_mm.datasets.dataset import load_dataset

    dataset = load_dataset(name)
    warn_if_stopped(dataset.location, dataset.metadata)
    return dataset


def warn_if_stopped(location: Location, metadata: Mapping[str, Any]) -> None:
    """Warn on stderr about a dataset whose collection was stopped."""
    if not metadata["marl_mm"].get("complete", True):
        print(
            f"marl-mm: {location.name} is of a collection that was stopped: "
            f"{metadata['total_steps']} steps",
            file=sys.stderr,
        )
