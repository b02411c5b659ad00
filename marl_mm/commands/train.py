"""marl-mm train: a policy from a dataset file or from episodes of its own."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import tyro

from marl_mm.algorithms.registry import ALGORITHMS, TUNED, names, preset
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.schedule import Schedule
from marl_mm.commands.options import REGISTERED
from marl_mm.commands.parser import Subcommand, parse_subcommand, value_of
from marl_mm.envs.registry import DEFAULT
from marl_mm.errors import UsageError
from marl_mm.runs import training
from marl_mm.runs.settings import with_values
from marl_mm.workers import available_cores

C = TypeVar("C")


@dataclass(frozen=True, kw_only=True)
class _Options:
    """Options of both ways to learn that Python has as arguments."""

    out: Path | None = None
    """Folder of the runs; seed s goes to OUT/s; default runs/ALGORITHM."""

    seeds: tuple[int, ...] = (0,)
    """Seeds of the runs, one run each: initial weights, batches, episodes."""

    json: bool = False
    """Print the final evaluations as JSON."""


@dataclass(frozen=True, kw_only=True)
class Offline(_Options, training.Offline, Generic[C]):
    """Learn from a dataset."""

    algorithm: Annotated[str, tyro.conf.Suppress]

    config: Annotated[C, tyro.conf.arg(name="")]

    dataset: str
    """Id, such as marl_mm/reach/pd-v0 or pd for short, or path; good-5k ships."""

    task: Annotated[
        str | None,
        tyro.conf.arg(
            help=f"To evaluate on: {REGISTERED}; default that of the dataset."
        ),
    ] = None

    workers: int = field(default_factory=available_cores)
    """Processes that run episodes, and that train seeds. The result does not depend on
    their number."""


@dataclass(frozen=True, kw_only=True)
class Online(_Options, training.Online, Generic[C]):
    """Learn from episodes of one's own."""

    algorithm: Annotated[str, tyro.conf.Suppress]

    config: Annotated[C, tyro.conf.arg(name="")]

    task: Annotated[str, tyro.conf.arg(help=f"To learn: {REGISTERED}.")] = DEFAULT

    schedule: Annotated[Schedule, tyro.conf.arg(name="")] = field(
        default_factory=Schedule
    )

    workers: int = field(default_factory=available_cores)
    """Processes that run episodes. The result does not depend on their number."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm train``."""
    repeated, arguments = _without_config(arguments)
    started_from = value_of(arguments, "--preset", TUNED)
    offline, online = names(online=False), names(online=True)
    commands: dict[str, type | Subcommand] = {
        name: _subcommand(name, started_from if name in arguments[:1] else TUNED)
        for name in (*offline, *online)
    }
    if set(online) & set(arguments[:1]) and value_of(arguments, "--dataset", ""):
        from marl_mm.runs.train import refuse_dataset

        refuse_dataset(arguments[0], value_of(arguments, "--dataset", ""))
    named = value_of(arguments, "--preset", "")  # asks for that preset's values
    if "--resume" in arguments and arguments[0] in commands and not named:
        commands[arguments[0]] = _resumed(arguments)
    if repeated is not None:
        commands[repeated.algorithm] = _repeated(repeated, arguments)
    name, options = parse_subcommand(
        commands,
        "marl-mm train",
        f"Train a policy: from a dataset file ({', '.join(offline)}), or from its own "
        "episodes. --config RUN/config.json, in place of an algorithm, repeats a run.",
        arguments,
    )
    _train(name, options)


def _train(name: str, options: Offline[Any] | Online[Any]) -> None:
    from marl_mm.progress import progress_bars
    from marl_mm.runs.train import trained  # torch takes a second to import

    out = options.out or Path("runs") / name
    dataset = options.dataset if isinstance(options, Offline) else None
    results = []
    try:
        with progress_bars() as bar:
            for run in trained(options, dataset, out, options.seeds, bar):
                best = run.best_evaluation
                result = {"run": str(run.folder), **run.evaluated.to_json()}
                results.append(result | ({"best": best.to_json()} if best else {}))
                if not options.json:
                    print(run.summary(), flush=True)
    finally:  # if some seeds diverge, others do not
        if options.json and results:  # in the order of the seeds
            results.sort(key=lambda r: options.seeds.index(int(Path(r["run"]).name)))
            print(json.dumps(results, indent=2))


def _without_config(
    arguments: Sequence[str],
) -> tuple[RunConfig | None, Sequence[str]]:
    """The record that ``--config`` names, and the words with its algorithm instead."""
    places = [i for i, word in enumerate(arguments) if word.split("=")[0] == "--config"]
    if not places:
        return None, arguments
    if not arguments[0].startswith("-"):
        raise UsageError(
            f"--config takes the algorithm of its run: leave out {arguments[0]!r}"
        )
    from marl_mm.runs.folder import read_config

    file = value_of(arguments, "--config", "")
    if not Path(file).exists():
        raise UsageError(f"there is no {file!r}, expected a run or its config.json")
    config = read_config(Path(file))
    (first, *_), rest = places, list(arguments)
    del rest[first : first + (1 if "=" in arguments[first] else 2)]
    return config, (config.algorithm, *rest)


def _repeated(config: RunConfig, arguments: Sequence[str]) -> Subcommand:
    """Options whose defaults are the values of a run's record."""
    from marl_mm.runs.folder import settings_of
    from marl_mm.runs.train import dataset_of

    if not value_of(arguments, "--dataset", ""):
        dataset_of(config)  # is that which it learnt from
    subcommand = _subcommand(config.algorithm, TUNED)
    options = with_values(subcommand.default, settings_of(config))
    return subcommand._replace(default=options)


def _resumed(arguments: Sequence[str]) -> Subcommand:
    """Options whose defaults are the values that the first run was made of."""
    from marl_mm.runs.folder import saved_settings

    name = arguments[0]
    out = Path(value_of(arguments, "--out", f"runs/{name}"))
    subcommand = _subcommand(name, TUNED)
    options = with_values(subcommand.default, saved_settings(out))
    return subcommand._replace(default=options)


def _subcommand(name: str, started_from: str) -> Subcommand:
    """An algorithm's options if nothing is said."""
    algorithm = ALGORITHMS.get(name)
    config = preset(name, started_from)
    settings: Any = {"algorithm": name, "config": config, "preset": started_from}
    if algorithm.online:
        options: Any = Online(**settings)
    else:
        options = Offline(**settings, dataset=tyro.MISSING)
    return Subcommand(options, algorithm.about, type(options)[type(config)])
