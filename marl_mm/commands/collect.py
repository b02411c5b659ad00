"""marl-mm collect: episodes of a scripted policy into a Minari dataset."""

import json
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

import gymnasium
import tyro

from marl_mm.collectors.collect import Collection, PolicyConfig, collect, make_collector
from marl_mm.collectors.pd import PdConfig
from marl_mm.collectors.random import RandomConfig
from marl_mm.commands.options import available_cores, check_positive, check_seed
from marl_mm.commands.parser import parse_subcommand
from marl_mm.datasets.card import card
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import Location, locate
from marl_mm.datasets.storage import refuse_foreign, write_dataset
from marl_mm.envs.config import config_dict, reach_config
from marl_mm.files import refuse_existing
from marl_mm.interrupts import deaf_to_interrupts
from marl_mm.progress import progress_bar


@dataclass(frozen=True)
class CollectOptions:
    """What every collector needs."""

    steps: int = 10_000
    """Least number of steps; the last episode is kept whole."""

    seed: int = 0
    """Of the dataset: episode i is seeded from (seed, i)."""

    workers: int = field(default_factory=available_cores)
    """Processes; the dataset does not depend on it."""

    dataset: str | None = None
    """Id or path; default marl_mm/TASK/COLLECTOR-v0 below $MINARI_DATASETS_PATH."""

    task: str = "Reach-v0"
    """Reach-v0, SmoothReach-v0 or PreciseReach-v0."""

    max_steps: int | None = None
    """Steps per episode; default 50 for pd, 25 for random."""

    overwrite: bool = False
    """Replace the dataset if it exists."""

    json: bool = False
    """Print the dataset's card as JSON."""


@dataclass(frozen=True)
class Pd(CollectOptions):
    """Steer the hand to the goal; keep the episodes that reach it."""

    policy: Annotated[PdConfig, tyro.conf.arg(name="")] = field(
        default_factory=PdConfig
    )


@dataclass(frozen=True)
class Random(CollectOptions):
    """Act uniformly at random; keep all episodes."""

    policy: Annotated[RandomConfig, tyro.conf.arg(name="")] = field(
        default_factory=RandomConfig
    )


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm collect``."""
    _, command = parse_subcommand(
        {"pd": Pd, "random": Random},
        "marl-mm collect",
        "Collect a dataset with a scripted policy.",
        arguments,
    )
    location = locate(command.dataset or _default_id(command.task, command.policy))
    collection = collect_dataset(
        location,
        command.policy,
        command.task,
        command.steps,
        command.seed,
        command.workers,
        command.max_steps,
        command.overwrite,
    )
    summary = card(load_dataset(location))
    if command.json:
        print(json.dumps(summary, indent=2))
    else:
        print(f"{location.folder}: {summary['steps']} steps, {_successes(summary)}")
    if not collection.complete:
        raise KeyboardInterrupt("stopped; the dataset holds the episodes until then")


def collect_dataset(
    location: Location,
    policy: PolicyConfig,
    task: str,
    steps: int,
    seed: int,
    workers: int,
    max_steps: int | None = None,
    overwrite: bool = False,
) -> Collection:
    """Collect and write one dataset; Ctrl-C leaves the episodes until then.

    Raises:
        UsageError: If an argument makes no sense or the dataset exists.
        KeyboardInterrupt: If Ctrl-C came before the first episode was kept.
    """
    check_positive(steps=steps, workers=workers)
    check_seed(seed)
    refuse_existing(location.folder, overwrite)
    refuse_foreign(location)
    collector = make_collector(policy)
    overrides = {"max_steps": collector.max_steps if max_steps is None else max_steps}
    check_positive(**overrides)
    config = reach_config(task, overrides)
    with progress_bar(f"collect {policy.name}", steps) as advance:
        collection = collect(collector, config, steps, seed, workers, advance)
    if not collection.episodes:
        raise KeyboardInterrupt("stopped before an episode was kept: nothing written")
    spec = deepcopy(gymnasium.spec(f"marl_mm/{task}"))  # the registry's own object
    spec.kwargs["overrides"] = overrides
    description: dict[str, Any] = {
        "task": task,
        "overrides": overrides,
        "config": config_dict(config),
        "collector": policy.name,
        "collector_config": asdict(policy),
        "seed": seed,
        "steps_asked": steps,
        "attempts": collection.attempts,
        "complete": collection.complete,
    }
    # A second Ctrl-C must not cost what the first one kept.
    with deaf_to_interrupts(forget=not collection.complete):
        write_dataset(location, collection.episodes, spec, description, overwrite)
    return collection


def _default_id(task: str, policy: PolicyConfig) -> str:
    name = task.removesuffix("-v0").replace("Reach", "-reach").strip("-").lower()
    return f"marl_mm/{name}/{policy.name}-v0"


def _successes(summary: dict[str, Any]) -> str:
    parts = [
        f"{direction} {value['episodes']} episodes, {100 * value['rate']:.0f} % reached"
        for direction, value in summary["success"].items()
        if value["episodes"]
    ]
    return "; ".join(parts)
