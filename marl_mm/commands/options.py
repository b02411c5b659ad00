"""Options and lines of output that several commands share."""

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import field, fields, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro

import marl_mm
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.datasets.location import Location
from marl_mm.envs.registry import TASKS
from marl_mm.runs.policies import AGENT

if TYPE_CHECKING:  # a help takes neither data nor the simulator
    from marl_mm.datasets.dataset import Dataset
    from marl_mm.eval.evaluate import Evaluation

T = TypeVar("T")

COMMITTED = Path(marl_mm.__file__).parent / "eval" / "results"
"""Folder of the committed results, in a clone."""

REGISTERED = " or ".join((", ".join(TASKS.names()[:-1]), TASKS.names()[-1]))
"""Names of the tasks, for help texts."""


def with_policies(options: type[T]) -> type[T]:
    """A class of options with the settings of every collector's policy, by its name."""
    settings = [
        (
            _attribute(name),
            Annotated[collector.config, tyro.conf.arg(name=name)],
            field(default_factory=collector.config),
        )
        for name, collector in COLLECTORS.items()
        if name != AGENT and fields(collector.config)
    ]
    made = make_dataclass(
        options.__name__,
        settings,
        bases=(options,),
        frozen=True,
    )
    made.__doc__ = options.__doc__
    return made


def config_of(name: str, options: Any) -> Any:
    """Settings of the policy of a name; None of one that is no collector's.

    Args:
        name: Name of a policy, or a path.
        options: Options of a class that ``with_policies`` made.
    """
    return getattr(options, _attribute(name), None)


def _attribute(name: str) -> str:
    """Field of a collector's settings, which is an identifier, and no option's name."""
    return "policy_" + re.sub(r"\W", "_", name)


def print_evaluations(evaluations: Sequence["Evaluation"]) -> None:
    """Print a table of evaluations; into a pipe, with names in full."""
    from rich.console import Console

    from marl_mm.eval.metrics import failures_in_words
    from marl_mm.eval.tables import evaluation_table

    console = Console(markup=False)
    if not console.is_terminal:
        longest = max(len(evaluation.policy) for evaluation in evaluations)
        console = Console(width=80 + longest, markup=False)
    console.print(evaluation_table(evaluations, console.width))
    for evaluation in evaluations:
        failures = evaluation.summary["all"].get("failures")
        if failures is not None:
            print(f"{evaluation.policy} failed: {failures_in_words(failures)}")


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
