"""marl-mm train: a policy from a dataset file or from episodes of its own."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from marl_mm.algorithms.fine_tuning import FineTuning
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, names, preset
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.schedule import Schedule
from marl_mm.commands.options import task_help
from marl_mm.commands.output import show
from marl_mm.commands.parser import Subcommand, parse_subcommand, value_of
from marl_mm.envs.registry import DEFAULT
from marl_mm.errors import CheckpointError, UsageError
from marl_mm.runs import training
from marl_mm.runs.settings import with_values
from marl_mm.workers import available_cores


@dataclass(frozen=True, kw_only=True)
class _Options:
    """Options of both ways to learn that Python has as arguments."""

    algorithm: Annotated[str, tyro.conf.Suppress]

    config: Annotated[Any, tyro.conf.arg(name="")]

    out: Path | None = None
    """Folder of the runs; seed s goes to OUT/s; default runs/ALGORITHM, with "-online"
    if they start from others."""

    seeds: tuple[int, ...] = (0,)
    """Seeds of the runs, one run each: initial weights, batches, episodes."""

    json: bool = False
    """Print the final evaluations as JSON."""


@dataclass(frozen=True, kw_only=True)
class Offline(_Options, training.Offline):
    """Learn from a dataset."""

    dataset: str
    """Id, such as marl_mm/reach/pd-v0 or pd for short, or path, or name of a named
    dataset; good-5k ships. With --from default that of the run."""

    start: Annotated[Path | None, tyro.conf.arg(aliases=("--from",))] = None
    """Run of the same algorithm, or folder of such runs by seed, to start from, with
    its dataset and settings where none are given: --online-steps goes on from there."""

    fine_tuning: Annotated[FineTuning, tyro.conf.arg(name="")] = field(
        default_factory=FineTuning
    )

    task: Annotated[
        str | None, task_help("To evaluate on: {}; default that of the dataset.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class Online(_Options, training.Online):
    """Learn from the algorithm's own episodes."""

    task: Annotated[str, task_help("To learn: {}.")] = DEFAULT

    schedule: Annotated[Schedule, tyro.conf.arg(name="")] = field(
        default_factory=Schedule
    )


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm train``."""
    repeated, arguments = _without_config(arguments)
    word = arguments[0] if arguments else ""
    named = value_of(arguments, "--preset", "")  # asks for that preset's values
    dataset = value_of(arguments, "--dataset", "")
    start = value_of(arguments, "--from", value_of(arguments, "--start", ""))
    offline, online = names(online=False), names(online=True)
    commands: dict[str, Any] = {
        name: _subcommand(name, named if name == word and named else TUNED)
        for name in (*offline, *online)
    }
    if word in online and dataset:
        from marl_mm.runs.train import refuse_dataset

        refuse_dataset(word, dataset)
    if repeated is not None:
        from marl_mm.runs.folder import settings_of
        from marl_mm.runs.starts import refuse_changed_start
        from marl_mm.runs.train import dataset_of

        if named:
            raise UsageError(
                "--config has its run's hyper-parameters: leave out --preset"
            )
        if not dataset and not value_of(arguments, "--demonstrations", ""):
            dataset_of(repeated)  # is that which it learnt from
        if not start and "--resume" not in arguments:
            refuse_changed_start(repeated)
        commands[word] = _subcommand(word, TUNED, settings_of(repeated))
    elif "--resume" in arguments and word in commands:
        from marl_mm.runs.folder import saved_settings

        default = f"runs/{word}-online" if start else f"runs/{word}"
        out = Path(value_of(arguments, "--out", default))
        saved = saved_settings(out)
        if named in ("", saved.get("preset", named)):  # of no run nothing is missing
            commands[word] = _subcommand(word, TUNED, saved or {"dataset": ""})
    elif start and word in offline and not named:
        from marl_mm.runs.starts import started_settings

        commands[word] = _subcommand(word, TUNED, started_settings(start))
    name, options = parse_subcommand(
        commands,
        "marl-mm train",
        "Train a policy from a dataset file, or from its own episodes "
        f"({', '.join(online)}). --config RUN/config.json, in place of an algorithm, "
        "repeats a run.",
        arguments,
    )
    _train(name, options)


def _subcommand(name: str, started_from: str, saved: Any = None) -> Subcommand:
    """An algorithm's default options; those of a run where it was saved."""
    algorithm = ALGORITHMS.get(name)
    settings: dict[str, Any] = {
        "algorithm": name,
        "config": preset(name, started_from),
        "preset": started_from,
        "workers": available_cores(),
    }
    options = (
        Online(**settings)
        if algorithm.online
        else Offline(**settings, dataset=tyro.MISSING)
    )
    record = saved or {}, "config.json", CheckpointError
    return Subcommand(with_values(options, *record), algorithm.about)


def _train(name: str, options: Offline | Online) -> None:
    from marl_mm.progress import progress_bars
    from marl_mm.runs.train import default_out, trained  # torch takes a second

    out = options.out or default_out(name, vars(options))
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
            show(results)


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
    from marl_mm.runs.folder import existing_config

    config = existing_config(value_of(arguments, "--config", ""))
    first = places[0]
    behind = first + (1 if "=" in arguments[first] else 2)
    return config, (config.algorithm, *arguments[:first], *arguments[behind:])
