"""What several commands share: defaults, and policies by name."""

import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import field, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro
from rich.console import Console

import marl_mm
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import Location
from marl_mm.envs.registry import DEFAULT, TASKS
from marl_mm.envs.task import Task
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import Evaluation
from marl_mm.eval.metrics import failures_in_words
from marl_mm.eval.tables import evaluation_table
from marl_mm.policy import Policy

T = TypeVar("T")

COMMITTED = Path(marl_mm.__file__).parent / "eval" / "results"
"""In a clone, the results that its tables are made of."""

REGISTERED = " or ".join((", ".join(TASKS.names()[:-1]), TASKS.names()[-1]))
"""The tasks, for helps."""

AGENT = "pretrained"
"""Name of the agent that ships, which needs no run folder."""


def policy_names() -> tuple[str, ...]:
    """Policies that need no run folder: the agent that ships, and all collectors'."""
    return AGENT, *(name for name in COLLECTORS.names() if name != AGENT)


def with_policies(options: type[T]) -> type[T]:
    """A class of options with the settings of every collector's policy, by its name."""
    settings = [
        (
            _attribute(name),
            Annotated[one.config, tyro.conf.arg(name=name)],
            field(default_factory=one.config),
        )
        for name, one in COLLECTORS.items()
        if name != AGENT and fields(one.config)
    ]
    made = make_dataclass(
        options.__name__,
        settings,
        bases=(options,),
        frozen=True,
    )
    made.__doc__ = options.__doc__
    return made


def named_policy(
    name: str, options: Any, task: Task, others: tuple[str, ...] = ()
) -> Policy:
    """A policy by name, or that of a run folder.

    Args:
        name: One of ``policy_names``, or a path.
        options: What ``with_policies`` made, with the settings of policies.
        task: What it is to act in.
        others: What else the command takes in this place.

    Raises:
        UsageError: If it is neither.
        CheckpointError: If the run's checkpoint is damaged.
    """
    if name != AGENT and name in COLLECTORS:
        collector = COLLECTORS.get(name)
        config = getattr(options, _attribute(name), None) or collector.config()
        return collector.policy(config, task)
    if name != AGENT and not Path(name).exists():
        raise UsageError(
            f"no policy {name!r}: expected {', '.join((*policy_names(), *others))}, a "
            "run folder or a checkpoint file"
        )
    from marl_mm.algorithms.policy import load_policy  # torch takes a second to import

    return load_policy(name)


def _attribute(name: str) -> str:
    """Field of a collector's settings, which is an identifier, and no option's name."""
    return "policy_" + re.sub(r"\W", "_", name)


def own_task(policies: Sequence[str]) -> str:
    """The task that all runs among some policies are for; without runs Reach-v0.

    Args:
        policies: As in ``named_policy``.

    Raises:
        UsageError: If there are several.
    """
    tasks: dict[str, str] = {}
    for name in policies:
        path = Path(name)
        config = (path.parent if path.is_file() else path) / "config.json"
        if name not in policy_names() and config.exists():
            tasks[json.loads(config.read_text()).get("task", DEFAULT)] = name
    if len(tasks) > 1:
        told = ", ".join(f"{name} for {task}" for task, name in sorted(tasks.items()))
        raise UsageError(f"runs for several tasks, {told}: choose one with --task")
    return next(iter(tasks), DEFAULT)


def print_evaluations(evaluations: Sequence[Evaluation]) -> None:
    """A table on the terminal; into a pipe, with names in full."""
    console = Console()
    if not console.is_terminal:
        longest = max(len(evaluation.policy) for evaluation in evaluations)
        console = Console(width=80 + longest)
    console.print(evaluation_table(evaluations, console.width))
    for evaluation in evaluations:
        failures = evaluation.summary["all"].get("failures")
        if failures is not None:
            print(f"{evaluation.policy} failed: {failures_in_words(failures)}")


def read_dataset(name: str | Location) -> Dataset:
    """A dataset, with a line on stderr if its collection was stopped.

    Raises:
        UnknownDatasetError: If there is none.
        DatasetError: If its files are damaged.
    """
    dataset = load_dataset(name)
    warn_if_stopped(dataset.location, dataset.metadata)
    return dataset


def warn_if_stopped(location: Location, metadata: Mapping[str, Any]) -> None:
    """Say so on stderr if a dataset holds less than was asked for."""
    if not metadata["marl_mm"].get("complete", True):
        print(
            f"marl-mm: {location.name} is of a collection that was stopped: "
            f"{metadata['total_steps']} steps",
            file=sys.stderr,
        )


def check_positive(**values: float) -> None:
    """Raise for the first value that is not positive.

    Raises:
        UsageError: Naming the option.
    """
    for name, value in values.items():
        if value < 1:
            option = name.replace("_", "-")
            raise UsageError(f"--{option} is {value}, expected >= 1")


def check_seeds(seeds: Sequence[int]) -> None:
    """Raise for seeds of runs that are none, negative or named twice.

    Raises:
        UsageError: Saying which.
    """
    if not seeds:
        raise UsageError("--seeds names no seed, expected at least one")
    if len(set(seeds)) < len(seeds):
        listed = " ".join(map(str, seeds))
        raise UsageError(f"--seeds is {listed}, expected each seed once")
    check_seed(*seeds)


def check_seed(*seeds: int) -> None:
    """Raise for a seed that is negative.

    Raises:
        UsageError: Naming it.
    """
    for seed in seeds:
        if seed < 0:
            raise UsageError(f"the seed is {seed}, expected >= 0")
