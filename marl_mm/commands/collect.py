"""marl-mm collect: episodes of a policy into a Minari dataset."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import tyro

from marl_mm.collectors.collect import PolicyConfig
from marl_mm.collectors.medium import MediumConfig
from marl_mm.collectors.pd import PdConfig
from marl_mm.collectors.pretrained import PretrainedConfig
from marl_mm.collectors.random import RandomConfig
from marl_mm.collectors.scripted import ScriptedConfig
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
from marl_mm.envs.config import TASKS


@dataclass(frozen=True)
class Pretrained(CollectOptions):
    """Let a learnt agent act; keep the episodes that reach the goal ("good" data)."""

    policy: Annotated[PretrainedConfig, tyro.conf.arg(name="")] = field(
        default_factory=PretrainedConfig
    )


@dataclass(frozen=True)
class Pd(CollectOptions):
    """Steer the hand to the goal; keep the episodes that reach it."""

    policy: Annotated[PdConfig, tyro.conf.arg(name="")] = field(
        default_factory=PdConfig
    )


@dataclass(frozen=True)
class Medium(CollectOptions):
    """Act at random first, then as a learnt agent; keep all episodes."""

    policy: Annotated[MediumConfig, tyro.conf.arg(name="")] = field(
        default_factory=MediumConfig
    )


@dataclass(frozen=True)
class Random(CollectOptions):
    """Act uniformly at random; keep all episodes."""

    policy: Annotated[RandomConfig, tyro.conf.arg(name="")] = field(
        default_factory=RandomConfig
    )


@dataclass(frozen=True)
class Scripted(CollectOptions):
    """Take the block, if there is one, and bring it to the goal; keep successes."""

    policy: Annotated[ScriptedConfig, tyro.conf.arg(name="")] = field(
        default_factory=ScriptedConfig
    )


KINDS = {
    "pretrained": Pretrained,
    "pd": Pd,
    "medium": Medium,
    "random": Random,
    "scripted": Scripted,
}


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm collect``."""
    commands: dict[str, type | Subcommand] = {**KINDS, "paper": Paper}
    if "--resume" in arguments and arguments[0] in KINDS:
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
        name = _default_id(command.task, command.policy)
    location = locate(name)
    collection = collect_dataset(location, command.policy, command)
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
    kind = KINDS[arguments[0]]
    options = kind()
    task = value_of(arguments, "--task", options.task)
    name = value_of(arguments, "--dataset", "") or _default_id(task, options.policy)
    if task not in TASKS:  # what is wrong with it is told later
        return Subcommand(options, kind.__doc__ or "")
    begun = begun_with(locate(name))
    if begun is not None and begun.get("collector") == options.policy.name:
        known = {key: begun[key] for key in ("task", "seed")}
        known |= begun["overrides"] | begun["collector_config"]
        options = with_values(options, known)
    return Subcommand(options, kind.__doc__ or "")


def _default_id(task: str, policy: PolicyConfig) -> str:
    folder = task.removesuffix("-v0").replace("Reach", "-reach").strip("-").lower()
    name = "good" if isinstance(policy, PretrainedConfig) else policy.name
    return f"marl_mm/{folder}/{name}-v0"


def _successes(summary: dict[str, Any]) -> str:
    parts = [
        f"{direction} {value['episodes']} episodes, {100 * value['rate']:.0f} % reached"
        for direction, value in summary["success"].items()
        if value["episodes"]
    ]
    return "; ".join(parts)
