"""marl-mm collect: episodes of a policy into a Minari dataset."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Generic, TypeVar

import tyro

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.commands.collect_dataset import (
    CollectOptions,
    collect_dataset,
)
from marl_mm.commands.collect_paper import Paper, collect_paper
from marl_mm.commands.collect_resume import begun_with
from marl_mm.commands.parser import (
    Subcommand,
    parse_subcommand,
    value_of,
    with_values,
)
from marl_mm.datasets.card import keep_card
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import locate
from marl_mm.envs.registry import TASKS

C = TypeVar("C")


@dataclass(frozen=True)
class CollectWith(CollectOptions, Generic[C]):
    """Options of a collection, and the collector's own."""

    policy: Annotated[C, tyro.conf.arg(name="")] = field(kw_only=True)


def _subcommand(name: str, options: Any = None) -> Subcommand:
    collector = COLLECTORS.get(name)
    options = options or CollectWith(policy=collector.config())
    kind = CollectWith[collector.config]  # type: ignore[name-defined]
    return Subcommand(options, collector.about, kind)


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm collect``."""
    commands: dict[str, type | Subcommand] = {
        name: _subcommand(name) for name in COLLECTORS.names()
    }
    commands["paper"] = Paper
    if "--resume" in arguments and arguments[0] in COLLECTORS:
        commands[arguments[0]] = _resumed(arguments)
    kind, command = parse_subcommand(
        commands,
        "marl-mm collect",
        "Collect a dataset with a scripted or a learnt policy.",
        arguments,
    )
    if isinstance(command, Paper):
        collect_paper(command)
        return
    name = command.dataset
    if name is None:
        name = _default_id(command.task, kind)
    location = locate(name)
    collection = collect_dataset(location, kind, command.policy, command)
    summary = keep_card(load_dataset(location))
    if command.json:
        print(json.dumps(summary, indent=2))
    else:
        print(f"{location.folder}: {summary['steps']} steps, {_successes(summary)}")
    if not collection.complete:
        named = f" --dataset {command.dataset}" if command.dataset else ""
        elsewhere = f" --task {command.task}" if not named else ""
        raise KeyboardInterrupt(
            "stopped; the dataset holds the episodes until then: go on with marl-mm "
            f"collect {kind}{named or elsewhere} --resume"
        )


def _resumed(arguments: Sequence[str]) -> Subcommand:
    """Options whose defaults are what the collection was begun with."""
    name = arguments[0]
    options = CollectWith(policy=COLLECTORS.get(name).config())
    task = value_of(arguments, "--task", options.task)
    dataset = value_of(arguments, "--dataset", "") or _default_id(task, name)
    if task not in TASKS:  # what is wrong with it is told later
        return _subcommand(name)
    begun = begun_with(locate(dataset))
    if begun is not None and begun.collector == name:
        known = {"task": begun.task, "seed": begun.seed}
        known |= {**begun.overrides, **(begun.collector_config or {})}
        options = with_values(options, known)
    return _subcommand(name, options)


def _default_id(task: str, collector: str) -> str:
    folder = task.removesuffix("-v0").replace("Reach", "-reach").strip("-").lower()
    name = COLLECTORS.get(collector).dataset or collector
    return f"marl_mm/{folder}/{name}-v0"


def _successes(summary: dict[str, Any]) -> str:
    parts = [
        f"{direction} {value['episodes']} episodes, {100 * value['rate']:.0f} % reached"
        for direction, value in summary["success"].items()
        if value["episodes"]
    ]
    return "; ".join(parts)
