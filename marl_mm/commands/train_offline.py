"""Runs that learn from a dataset file."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
import tyro

from marl_mm.algorithms.algorithm import OfflineAlgorithm
from marl_mm.algorithms.checkpoint import FILE, read_checkpoint
from marl_mm.algorithms.mabc import Mabc, MabcConfig
from marl_mm.algorithms.matd3_bc import Matd3Bc, Matd3BcConfig
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.presets import Preset, offline_preset
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.speed import prepare_for_small_networks
from marl_mm.algorithms.td3_bc import Td3Bc, Td3BcConfig
from marl_mm.algorithms.train import resume_seeds, train
from marl_mm.commands.options import check_positive
from marl_mm.commands.runs import (
    CURVE,
    EVALUATION,
    TrainOptions,
    check_run,
    continue_run,
    curve_point,
    evaluate_run,
    read_config,
    start_run,
)
from marl_mm.datasets.dataset import Dataset
from marl_mm.envs.config import reach_config
from marl_mm.envs.rollout import Rollouts
from marl_mm.envs.terms import judge
from marl_mm.errors import DatasetError, DivergedError, UsageError, WorkerDiedError
from marl_mm.eval.evaluate import Evaluation, evaluate_with
from marl_mm.eval.figures import learning_curve
from marl_mm.files import only_here
from marl_mm.progress import Bar, distant_bars, progress_bars, show_distant_bars
from marl_mm.versions import versions
from marl_mm.workers import Workers


@dataclass(frozen=True, kw_only=True)
class TrainOffline(TrainOptions):
    """What every offline algorithm needs."""

    dataset: str
    """Id, such as marl_mm/reach/pd-v0 or pd for short, or path; good-5k ships."""

    preset: Preset = "tuned"
    """Hyper-parameters that the defaults below are of: ours, or the paper's Table 3."""

    task: str | None = None
    """To evaluate on: Reach-v0, SmoothReach-v0 or PreciseReach-v0; default that of the
    dataset."""

    require_success: bool = True
    """Refuse a dataset in which no episode reaches its goal."""

    device: Literal["cpu", "cuda"] = "cpu"
    """Where to train. On a CPU each seed is a process of one thread, about --workers at
    once; on a GPU all seeds are trained side by side."""

    curve_every: int = 2_000
    """Updates between points of the learning curve."""

    curve_episodes: int = 20
    """Goals per point of the learning curve."""


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


_Trained = list[tuple[Path, Evaluation]] | DivergedError
"""Runs and their evaluations, or why there are none."""


def train_offline(
    dataset: Dataset, options: Offline, runs: Mapping[int, Path]
) -> Iterator[tuple[Path, Evaluation]]:
    """Train, evaluate, and leave a folder of each seed's run, as they come.

    On a CPU seeds are trained in processes of their own, and on a GPU all at once.

    Raises:
        DatasetError: If there is nothing to learn from.
        DivergedError: At the end, if a seed's losses were not finite; there may be a
            checkpoint from before.
        KeyboardInterrupt: After Ctrl-C, saying how to go on.
    """
    check_offline(dataset, options, runs)
    # Those of an incomplete last round go beside the others: no core is idle then.
    processes = min(len(runs), options.workers + len(runs) % options.workers)
    with ExitStack() as stack:
        for run in runs.values():
            stack.enter_context(only_here(run))
        for seed, run in runs.items():
            if options.resume and (run / FILE).exists():
                continue_run(run, {"updates": options.config.updates})
            else:
                start_run(run, _run_config(dataset, options, seed))
        if options.device == "cuda":
            parts: Iterable[_Trained] = _together(dataset, options, runs)
        elif min(processes, options.workers) > 1:
            parts = _apart(dataset, options, runs, processes)
        else:
            parts = (_here(dataset, options, {s: run}) for s, run in runs.items())
        failures = []
        for trained in parts:
            if isinstance(trained, DivergedError):
                failures.append(trained)
            else:
                yield from trained
        if failures:
            raise DivergedError("; ".join(map(str, failures)))


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
    if options.require_success and not dataset.arrays.successes().any():
        raise DatasetError(
            f"none of the {len(dataset.arrays)} episodes of {dataset.location.name} "
            "reaches its goal, so that there is nothing to imitate; with "
            "--no-require-success (and --imitate all) it is tried all the same"
        )
    reach_config(_task(dataset, options))
    ignored = (*_MAY_DIFFER, *(_CONTINUED if further else ()))
    for seed, run in runs.items():
        check_run(run, _run_config(dataset, options, seed), options, ignored)
        if options.resume and (run / FILE).exists():
            _check_end(options, run)
    _algorithm(dataset, options, list(runs))  # which refuses what it cannot learn from


def _check_end(options: Offline, run: Path) -> None:
    """Raise if a run cannot go on to the updates asked for."""
    done, asked = read_metrics(run)[-1]["step"], options.config.updates
    if done > asked:
        raise UsageError(f"{run} has {done} updates already, --updates is {asked}")
    before = read_config(run)["updates"]
    if asked != before and getattr(options.config, "q_weight_end", None) is not None:
        raise UsageError(
            f"{run} was to end at {before} updates, and --q-weight-end with it: "
            f"--updates {asked} needs a run of its own"
        )


def _apart(
    dataset: Dataset, options: Offline, runs: Mapping[int, Path], processes: int
) -> Iterator[_Trained]:
    """Seeds in processes of their own, which Ctrl-C or one that dies stops."""
    context = get_context("spawn")
    messages, stop = context.Queue(), context.Event()
    alone = replace(options, workers=1)
    arguments = dataset, alone, messages, stop
    go_on = f"{', '.join(map(str, runs.values()))}: go on with --resume"
    try:
        with (
            show_distant_bars(messages),
            Workers(processes, _begin_process, arguments) as pool,
        ):
            try:
                yield from pool.completed(_train_in_process, runs.items(), ahead=1)
            except BaseException:
                stop.set()
                raise
    except WorkerDiedError as error:
        raise WorkerDiedError(f"{error}; {go_on}") from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; {go_on}") from None


_process: tuple[Any, ...] = ()
"""What a process that trains seeds was begun with."""


def _begin_process(*arguments: Any) -> None:
    global _process
    _process = arguments


def _train_in_process(cell: tuple[int, Path]) -> _Trained:
    dataset, options, messages, stop = _process
    return _try(dataset, options, dict([cell]), distant_bars(messages, stop))


def _together(
    dataset: Dataset, options: Offline, runs: Mapping[int, Path]
) -> Iterator[_Trained]:
    """Seeds side by side in this process, those together that stand at one update."""
    steps: dict[int, dict[int, Path]] = {}
    for seed, run in runs.items():
        begun = (run / FILE).exists()
        step = read_checkpoint(run)["state"]["step"] if begun else 0
        steps.setdefault(step, {})[seed] = run
    for group in steps.values():
        yield _here(dataset, options, group)


def _here(dataset: Dataset, options: Offline, runs: Mapping[int, Path]) -> _Trained:
    with progress_bars() as bar:
        return _try(dataset, options, runs, bar)


def _try(
    dataset: Dataset, options: Offline, runs: Mapping[int, Path], bar: Bar
) -> _Trained:
    """Train; that one seed diverges is no reason to stop others."""
    try:
        return _train(dataset, options, runs, bar)
    except DivergedError as error:
        return error


def _train(
    dataset: Dataset, options: Offline, runs: Mapping[int, Path], bar: Bar
) -> list[tuple[Path, Evaluation]]:
    """Train what has been started, and evaluate one seed after the other."""
    prepare_for_small_networks()
    algorithm = _algorithm(dataset, options, list(runs))
    if any((run / FILE).exists() for run in runs.values()):
        resume_seeds(algorithm, list(runs.values()), _CONTINUED)
    task = _task(dataset, options)
    label = f"{algorithm.name} {' '.join(map(str, runs))}"
    advance = bar(label, options.config.updates)
    with Rollouts(reach_config(task), options.workers) as rollouts:

        def point(policy: LearnedPolicy) -> dict[str, float]:
            goals = options.eval_seed + 1  # not those of the final evaluation
            count = options.curve_episodes
            return curve_point(evaluate_with(rollouts, policy, count, goals, task))

        train(algorithm, list(runs.values()), point, options.curve_every, advance)
    return [
        (run, evaluate_offline_run(dataset, options, run, bar, f"eval {seed}"))
        for seed, run in runs.items()
    ]


def evaluate_offline_run(
    dataset: Dataset, options: Offline, run: Path, bar: Bar, label: str
) -> Evaluation:
    """Draw a trained run's learning curve; evaluate its last policy."""
    learning_curve(read_metrics(run), run / CURVE)
    task = _task(dataset, options)
    return evaluate_run(run, options, task, FILE, EVALUATION, bar, label)


def _algorithm(
    dataset: Dataset, options: Offline, seeds: Sequence[int]
) -> OfflineAlgorithm:
    rewards = partial(judge, config=reach_config(_dataset_task(dataset)))
    kind, _ = _KINDS[type(options.config)]
    algorithm: OfflineAlgorithm = kind(
        options.config, dataset.arrays, rewards, seeds, options.device
    )
    return algorithm


def _task(dataset: Dataset, options: Offline) -> str:
    """What is evaluated on."""
    return options.task or _dataset_task(dataset)


def _dataset_task(dataset: Dataset) -> str:
    task: str = dataset.metadata["marl_mm"]["task"]
    return task


_MAY_DIFFER = ("preset", "device", "eval_episodes")
"""Of a run's config, when it is resumed."""

_CONTINUED = ("updates",)
"""What may be another then: more of it only continues. (The evaluation at the former
end stays in the learning curve.)"""


def _run_config(dataset: Dataset, options: Offline, seed: int) -> dict[str, Any]:
    """What a run is made of; ``config.json``."""
    kind, _ = _KINDS[type(options.config)]
    return {
        "algorithm": kind.name,
        "preset": options.preset,
        "seed": seed,
        "device": options.device,
        "task": _task(dataset, options),
        "dataset": dataset.identity(),
        "curve_every": options.curve_every,
        "curve_episodes": options.curve_episodes,
        "eval_episodes": options.eval_episodes,
        "eval_seed": options.eval_seed,
        "packages": versions(),
        **asdict(options.config),
    }
