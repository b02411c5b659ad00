"""What offline runs are made of: options, config, algorithm, and what is refused."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar

import torch
import tyro

from marl_mm.algorithms.algorithm import OfflineAlgorithm
from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, preset
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.speed import resolved
from marl_mm.commands.options import REGISTERED, check_positive
from marl_mm.commands.runs import (
    TrainOptions,
    check_run,
    plugins_of,
    read_config,
)
from marl_mm.datasets.dataset import Dataset
from marl_mm.envs.registry import make_task
from marl_mm.errors import DatasetError, UsageError
from marl_mm.layout_diff import refuse_other_layout
from marl_mm.versions import versions

C = TypeVar("C")


@dataclass(frozen=True, kw_only=True)
class Offline(TrainOptions, Generic[C]):
    """What every offline algorithm needs, and its hyper-parameters."""

    algorithm: Annotated[str, tyro.conf.Suppress]
    """Registered name."""

    config: Annotated[C, tyro.conf.arg(name="")]
    """Hyper-parameters."""

    dataset: str
    """Id, such as marl_mm/reach/pd-v0 or pd for short, or path; good-5k ships."""

    preset: str = TUNED
    """Hyper-parameters that the defaults below are of: tuned, ours, or paper, those of
    Table 3, where the algorithm has them."""

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


def offline_options(algorithm: str, name: str = TUNED, **changes: Any) -> Offline[Any]:
    """The options of an offline algorithm, with some replaced."""
    config = preset(algorithm, name)
    return Offline(algorithm=algorithm, config=config, preset=name, **changes)


def with_exact_precision(options: Offline[Any]) -> Offline[Any]:
    """Options that say what ``--precision auto`` means on this machine.

    A run goes on with that elsewhere, too.
    """
    precision = resolved(options.config.precision)
    return replace(options, config=replace(options.config, precision=precision))


def check_offline(
    dataset: Dataset,
    options: Offline[Any],
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
    refuse_other_layout(
        dataset.location.name, dataset.arrays.layout, task, make_task(task).layout
    )
    ignored = (*_MAY_DIFFER, *(CONTINUED if further else ()))
    for seed, run in runs.items():
        check_run(run, offline_config(dataset, options, seed), options, ignored)
        if options.resume and (run / FILE).exists():
            _check_end(options, run)
    # Which refuses what it cannot learn from.
    offline_algorithm(dataset, options, list(runs))


def _check_end(options: Offline[Any], run: Path) -> None:
    """Raise if a run cannot go on to the updates asked for."""
    rows, asked = read_metrics(run), options.config.updates
    done = rows[-1]["step"] if rows else 0
    if done > asked:
        raise UsageError(f"{run} has {done} updates already, --updates is {asked}")
    before = read_config(run).settings["updates"]
    if asked != before and getattr(options.config, "q_weight_end", None) is not None:
        raise UsageError(
            f"{run} was to end at {before} updates, and --q-weight-end with it: "
            f"--updates {asked} needs a run of its own"
        )


def offline_algorithm(
    dataset: Dataset, options: Offline[Any], seeds: Sequence[int]
) -> OfflineAlgorithm:
    """A fresh one, for several seeds at once."""
    judge = make_task(dataset.provenance.task)
    learner = ALGORITHMS.get(options.algorithm).learner
    algorithm: OfflineAlgorithm = learner(
        options.config, dataset.arrays, judge, seeds, options.device
    )
    return algorithm


def task_of(dataset: Dataset, options: Offline[Any]) -> str:
    """What is evaluated on."""
    return options.task or dataset.provenance.task


_MAY_DIFFER = ("preset", "device", "eval_episodes")
"""Of a run's config, when it is resumed."""

CONTINUED = ("updates",)
"""What may be another then: more of it only continues. (The evaluation at the former
end stays in the learning curve.)"""


def offline_config(dataset: Dataset, options: Offline[Any], seed: int) -> RunConfig:
    """What a run is made of."""
    task = task_of(dataset, options)
    own = "device", "max_steps", "curve_every", "curve_episodes"
    evaluated = "eval_episodes", "eval_seed"
    return RunConfig(
        algorithm=options.algorithm,
        preset=options.preset,
        seed=seed,
        task=task,
        dataset=dataset.identity(),
        packages=versions(),
        plugins=plugins_of(options.algorithm, task),
        settings={
            **{name: getattr(options, name) for name in (*own, *evaluated)},
            **asdict(options.config),
        },
    )
