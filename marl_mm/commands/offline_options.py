"""What offline runs are made of: options, config, algorithm, and what is refused."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
import tyro

from marl_mm.algorithms.algorithm import OfflineAlgorithm
from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.mabc import Mabc, MabcConfig
from marl_mm.algorithms.matd3_bc import Matd3Bc, Matd3BcConfig
from marl_mm.algorithms.presets import Preset, offline_preset
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.speed import resolved
from marl_mm.algorithms.td3_bc import Td3Bc, Td3BcConfig
from marl_mm.commands.options import REGISTERED, check_positive
from marl_mm.commands.runs import (
    TrainOptions,
    check_run,
    read_config,
)
from marl_mm.datasets.dataset import Dataset
from marl_mm.envs.config import reach_config
from marl_mm.envs.terms import judge
from marl_mm.errors import DatasetError, UsageError
from marl_mm.versions import versions


@dataclass(frozen=True, kw_only=True)
class TrainOffline(TrainOptions):
    """What every offline algorithm needs."""

    dataset: str
    """Id, such as marl_mm/reach/pd-v0 or pd for short, or path; good-5k ships."""

    preset: Preset = "tuned"
    """Hyper-parameters that the defaults below are of: ours, or the paper's Table 3."""

    task: Annotated[
        str | None,
        tyro.conf.arg(
            help=f"To evaluate on: {REGISTERED}; default that of the dataset."
        ),
    ] = None

    require_success: bool = True
    """Refuse a dataset in which no episode reaches its goal."""

    device: Literal["cpu", "cuda"] = "cpu"
    """Where to train. On a CPU each seed is a process of one thread, about --workers at
    once; on a GPU all seeds are trained side by side."""

    curve_every: int = 2_000
    """Updates between points of the learning curve."""

    curve_episodes: int = 20
    """Goals per point of the learning curve."""

    stop_unsound: bool = True
    """Stop a run when a critic's values are a hundred times what any return can be;
    otherwise only when something is not finite."""


@dataclass(frozen=True, kw_only=True)
class TrainMabc(TrainOffline):
    """Behaviour cloning with two decentralised actors (paper, Sec. 4.4)."""

    config: Annotated[MabcConfig, tyro.conf.arg(name="")]


@dataclass(frozen=True, kw_only=True)
class TrainTd3Bc(TrainOffline):
    """One agent that sees and sets everything (paper, Algorithm 2)."""

    config: Annotated[Td3BcConfig, tyro.conf.arg(name="")]


@dataclass(frozen=True, kw_only=True)
class TrainMatd3Bc(TrainOffline):
    """Two decentralised actors, centralised critics (Pan 2022)."""

    config: Annotated[Matd3BcConfig, tyro.conf.arg(name="")]


Offline = TrainMabc | TrainTd3Bc | TrainMatd3Bc

OFFLINE = {
    "mabc": "MABC: behaviour cloning with two decentralised actors (paper, Sec. 4.4).",
    "td3-bc": "TD3+BC: one agent that sees and sets everything (paper, Algorithm 2).",
    "matd3-bc": "MATD3+BC: two decentralised actors, centralised critics (Pan 2022).",
}
"""Algorithms, and what helps say of them."""

_KINDS: dict[type, tuple[Any, Any]] = {
    MabcConfig: (Mabc, TrainMabc),
    Td3BcConfig: (Td3Bc, TrainTd3Bc),
    Matd3BcConfig: (Matd3Bc, TrainMatd3Bc),
}
"""Algorithm and options by the class of the hyper-parameters."""


def offline_options(algorithm: str, name: Preset = "tuned", **changes: Any) -> Offline:
    """The options of an offline algorithm, with some replaced."""
    config = offline_preset(algorithm, name)
    _, kind = _KINDS[type(config)]
    options: Offline = kind(config=config, preset=name, **changes)
    return options


def with_exact_precision(options: Offline) -> Offline:
    """Options that say what ``--precision auto`` means on this machine.

    A run goes on with that elsewhere, too.
    """
    changed: Any = options
    precision = resolved(options.config.precision)
    changed = replace(changed, config=replace(changed.config, precision=precision))
    exact: Offline = changed
    return exact


def check_offline(
    dataset: Dataset,
    options: Offline,
    runs: Mapping[int, Path],
    further: bool = True,
) -> None:
    """Raise before any work is done for what would stop a run; see ``check_run``.

    Args:
        dataset: What is to be learnt from.
        options: How.
        runs: Folders by seed.
        further: Whether runs may go on to more updates than they were to make.
    """
    check_positive(
        curve_every=options.curve_every, curve_episodes=options.curve_episodes
    )
    if options.device == "cuda" and not torch.cuda.is_available():
        raise UsageError(
            "--device is cuda, but torch finds no such GPU: use --device cpu, or "
            "install a torch that is built for yours"
        )
    fresh = not all(options.resume and (run / FILE).exists() for run in runs.values())
    if options.require_success and fresh and not dataset.arrays.successes().any():
        others = " (and --imitate all)" if hasattr(options.config, "imitate") else ""
        raise DatasetError(
            f"none of the {len(dataset.arrays)} episodes of {dataset.location.name} "
            "reaches its goal, so that there is nothing to imitate; with "
            f"--no-require-success{others} it is tried all the same"
        )
    task = task_of(dataset, options)
    if reach_config(task, options.overrides).layout is not dataset.arrays.layout:
        raise UsageError(
            f"{dataset.metadata['dataset_id']} is of {_dataset_task(dataset)}, whose "
            f"states and actions are not those of --task {task}"
        )
    ignored = (*_MAY_DIFFER, *(CONTINUED if further else ()))
    for seed, run in runs.items():
        check_run(run, offline_config(dataset, options, seed), options, ignored)
        if options.resume and (run / FILE).exists():
            _check_end(options, run)
    # Which refuses what it cannot learn from.
    offline_algorithm(dataset, options, list(runs))


def _check_end(options: Offline, run: Path) -> None:
    """Raise if a run cannot go on to the updates asked for."""
    rows, asked = read_metrics(run), options.config.updates
    done = rows[-1]["step"] if rows else 0
    if done > asked:
        raise UsageError(f"{run} has {done} updates already, --updates is {asked}")
    before = read_config(run)["updates"]
    if asked != before and getattr(options.config, "q_weight_end", None) is not None:
        raise UsageError(
            f"{run} was to end at {before} updates, and --q-weight-end with it: "
            f"--updates {asked} needs a run of its own"
        )


def offline_algorithm(
    dataset: Dataset, options: Offline, seeds: Sequence[int]
) -> OfflineAlgorithm:
    """A fresh one, for several seeds at once."""
    rewards = partial(judge, config=reach_config(_dataset_task(dataset)))
    kind, _ = _KINDS[type(options.config)]
    algorithm: OfflineAlgorithm = kind(
        options.config, dataset.arrays, rewards, seeds, options.device
    )
    return algorithm


def task_of(dataset: Dataset, options: Offline) -> str:
    """What is evaluated on."""
    return options.task or _dataset_task(dataset)


def _dataset_task(dataset: Dataset) -> str:
    task: str = dataset.metadata["marl_mm"]["task"]
    return task


_MAY_DIFFER = ("preset", "device", "eval_episodes")
"""Of a run's config, when it is resumed."""

CONTINUED = ("updates",)
"""What may be another then: more of it only continues. (The evaluation at the former
end stays in the learning curve.)"""


def offline_config(dataset: Dataset, options: Offline, seed: int) -> dict[str, Any]:
    """What a run is made of; ``config.json``."""
    kind, _ = _KINDS[type(options.config)]
    return {
        "algorithm": kind.name,
        "preset": options.preset,
        "seed": seed,
        "device": options.device,
        "task": task_of(dataset, options),
        "max_steps": options.max_steps,
        "dataset": dataset.identity(),
        "curve_every": options.curve_every,
        "curve_episodes": options.curve_episodes,
        "eval_episodes": options.eval_episodes,
        "eval_seed": options.eval_seed,
        "packages": versions(),
        **asdict(options.config),
    }
