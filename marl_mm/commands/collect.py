"""marl-mm collect: episodes of a policy into a Minari dataset."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import tyro

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.commands.options import CORES, task_help
from marl_mm.commands.output import show
from marl_mm.commands.parser import Subcommand, parse_subcommand, value_of
from marl_mm.datasets.card import card, card_text, keep_card
from marl_mm.envs.registry import DEFAULT, TASKS
from marl_mm.errors import DatasetError, UsageError
from marl_mm.progress import progress_bars
from marl_mm.runs.collect import begun_settings, collect_into, default_dataset
from marl_mm.runs.collecting import Collecting
from marl_mm.runs.making import Datasets
from marl_mm.runs.paper import PAPER
from marl_mm.runs.settings import check_positive, check_seed, with_values
from marl_mm.runs.sources import seeded
from marl_mm.workers import Executor, available_cores


@dataclass(frozen=True)
class Collect(Collecting):
    """Options of a collection, and the collector's own."""

    task: Annotated[str, task_help("{}.")] = DEFAULT

    dataset: str | None = None
    """Id below $MINARI_DATASETS_PATH, or path; default marl_mm/TASK/COLLECTOR-v0, of
    pretrained marl_mm/TASK/good-v0. A recipe's name is short for its id, another word
    for marl_mm/reach/WORD-v0."""

    json: bool = False
    """Print the dataset's card as JSON."""

    policy: Annotated[Any, tyro.conf.arg(name="")] = field(kw_only=True)


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm collect``."""
    begun = _begun(arguments) if "--resume" in arguments else {}
    commands: dict[str, Any] = {
        name: Subcommand(_options(name, begun), collector.about)
        for name, collector in COLLECTORS.items()
    }
    kind, command = parse_subcommand(
        commands | {"paper": _paper},
        "marl-mm collect",
        "Collect a dataset with a scripted or a learnt policy.",
        arguments,
    )
    if kind == "paper":
        command()
        return
    name = command.dataset
    if name is None:
        name = default_dataset(command.task, kind)
    with progress_bars() as bar:
        data, complete = collect_into(name, kind, command.policy, command, bar)
    summary = card(data)
    text = f"{data.location.folder}: {summary['steps']} steps, {_successes(summary)}"
    show(summary, text, command.json)
    if not complete:
        named = command.dataset
        words = ("--dataset", named) if named else ("--task", command.task)
        raise KeyboardInterrupt(
            "stopped; the dataset holds the episodes until then: go on with marl-mm "
            f"collect {kind} {shlex.join(words)} --resume"
        )


def _options(name: str, settings: Mapping[str, Any]) -> Collect:
    options = Collect(policy=COLLECTORS.get(name).config(), workers=available_cores())
    return with_values(options, settings, "the dataset's record", DatasetError)


def _begun(arguments: Sequence[str]) -> Mapping[str, Any]:
    """Settings that the collection to resume was begun with, as defaults."""
    name, task = arguments[0], value_of(arguments, "--task", DEFAULT)
    if name not in COLLECTORS or task not in TASKS:  # is refused later
        return {}
    dataset = value_of(arguments, "--dataset", "") or default_dataset(task, name)
    return begun_settings(dataset, name)


def _paper(
    *,
    scale: float = 1.0,
    seed: int = 0,
    workers: int = CORES,
    executor: Executor = "local",
    resume: bool = False,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Make what is missing of the paper's datasets, marl_mm/reach/NAME-v0.

    good-30k, good-60k, pd-30k, random-10k, medium-5k and the mixes of Table 4. The same
    command goes on after an interruption. good-60k begins with good-30k.

    Args:
        scale: Share of the paper's steps, to see that everything works.
        seed: Seed of all datasets.
        workers: Processes; the datasets do not depend on their number.
        executor: Processes of this machine, or of a Ray cluster.
        resume: Go on after an interruption: it does so anyway.
        overwrite: Replace those that are damaged, of another seed or of a larger scale.
        json: Print the cards as JSON.
    """
    check_seed(seed)
    check_positive(workers=workers)
    if not 0.0 < scale <= 100.0:
        raise UsageError(f"--scale is {scale}, expected a share such as 0.01")
    pool: dict[str, Any] = {"workers": workers, "executor": executor}
    cards = []
    with progress_bars() as bar:
        datasets = Datasets(bar=bar, scale=scale, overwrite=overwrite, **pool)
        for data in PAPER:
            cards.append(keep_card(datasets.make(seeded(data, seed))))
            if not json:
                print(card_text(cards[-1]), end="\n\n", flush=True)
    if json:
        show(cards)


def _successes(summary: dict[str, Any]) -> str:
    parts = [
        f"{direction} {value['episodes']} episodes, {100 * value['rate']:.0f} % reached"
        for direction, value in summary["success"].items()
        if value["episodes"]
    ]
    return "; ".join(parts)
