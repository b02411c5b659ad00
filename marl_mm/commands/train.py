"""marl-mm train: a policy from a dataset file or from episodes of its own."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tyro

from marl_mm.algorithms.registry import ALGORITHMS, TUNED, names
from marl_mm.commands.offline_options import Offline, offline_options
from marl_mm.commands.options import read_dataset
from marl_mm.commands.parser import Subcommand, parse_subcommand, value_of
from marl_mm.commands.runs import check_options, saved_options, told
from marl_mm.commands.train_offline import train_offline
from marl_mm.commands.train_online import (
    Online,
    check_online,
    check_online_run,
    online_options,
    train_online_run,
)
from marl_mm.errors import UsageError


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm train``."""
    preset = value_of(arguments, "--preset", TUNED)
    offline, online = names(online=False), names(online=True)
    if set(online) & set(arguments[:1]) and value_of(arguments, "--dataset", ""):
        raise UsageError(
            f"{arguments[0]} learns from episodes of its own and takes no --dataset: "
            f"use {', '.join(offline)}, or --demonstrations"
        )
    commands: dict[str, type | Subcommand] = {
        name: _subcommand(name, preset if name in arguments[:1] else TUNED)
        for name in (*offline, *online)
    }
    named = value_of(arguments, "--preset", "")  # asks for that one's values
    if "--resume" in arguments and arguments[0] in commands and not named:
        commands[arguments[0]] = _resumed(arguments, preset)
    name, options = parse_subcommand(
        commands,
        "marl-mm train",
        f"Train a policy: from a dataset file ({', '.join(offline)}), or from its own "
        "episodes.",
        arguments,
    )
    out = options.out or Path("runs") / name
    check_options(options, out)
    runs = {seed: out / str(seed) for seed in options.seeds}
    trained = _offline(options, runs) if name in offline else _online(options, runs)
    results = []
    try:
        for run, last, best in trained:
            result = {"run": str(run), **last.to_json()}
            results.append(result | ({"best": best.to_json()} if best else {}))
            if not options.json:
                print(told(run, last, best), flush=True)
    finally:  # if some seeds diverge, others do not
        if options.json and results:
            print(json.dumps(results, indent=2))


def _offline(options: Offline[Any], runs: dict[int, Path]) -> Any:
    dataset = read_dataset(options.dataset)
    for run, evaluation in train_offline(dataset, options, runs):
        yield run, evaluation, None


def _online(options: Online[Any], runs: dict[int, Path]) -> Any:
    check_online(options)
    for seed, run in runs.items():
        check_online_run(options, seed, run)
    for seed, run in runs.items():
        yield run, *train_online_run(options, seed, run)


def _resumed(arguments: Sequence[str], preset: str) -> Subcommand:
    """Options whose defaults are the values that the first run was made of."""
    name = arguments[0]
    out = Path(value_of(arguments, "--out", f"runs/{name}"))
    subcommand = _subcommand(name, preset)
    return subcommand._replace(default=saved_options(subcommand.default, out))


def _subcommand(name: str, preset: str) -> Subcommand:
    """An algorithm's options if nothing is said."""
    algorithm = ALGORITHMS.get(name)
    kind: Any = Online if algorithm.online else Offline
    if algorithm.online:
        options: Any = online_options(name, preset)
    else:
        options = offline_options(name, preset, dataset=tyro.MISSING)
    return Subcommand(options, algorithm.about, kind[type(options.config)])
