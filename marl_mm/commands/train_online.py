"""Runs that learn from episodes of their own."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import tyro

from marl_mm.algorithms.checkpoint import BEST, FILE
from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.online import OnlineAlgorithm, Schedule, is_flat, train_online
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, preset
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.runlog import CurvePoint, read_metrics
from marl_mm.algorithms.train import resume
from marl_mm.commands.options import REGISTERED, check_positive
from marl_mm.commands.runs import (
    BEST_EVALUATION,
    CURVE,
    EVALUATION,
    TrainOptions,
    check_run,
    continue_run,
    curve_point,
    evaluate_run,
    plugins_of,
    read_config,
    start_run,
)
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.envs.rollout import EpisodePlan, Rollouts, episode_seed
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import Evaluation, evaluate_with
from marl_mm.files import only_here
from marl_mm.progress import progress_bar, progress_bars
from marl_mm.versions import versions

C = TypeVar("C")


@dataclass(frozen=True, kw_only=True)
class Online(TrainOptions, Generic[C]):
    """What every online algorithm needs, and its hyper-parameters."""

    algorithm: Annotated[str, tyro.conf.Suppress]
    """Registered name."""

    config: Annotated[C, tyro.conf.arg(name="")]
    """Hyper-parameters."""

    task: Annotated[str, tyro.conf.arg(help=f"To learn: {REGISTERED}.")] = DEFAULT

    preset: str = TUNED
    """Hyper-parameters that the defaults below are of: tuned, ours, or paper, those of
    Table 2, where the algorithm has them."""

    demonstrations: str | None = None
    """Dataset, id or path, whose episodes are replayed, too."""

    curve_episodes: int = 50
    """Goals per point of the learning curve."""

    schedule: Annotated[Schedule, tyro.conf.arg(name="")] = field(
        default_factory=Schedule
    )


def online_options(algorithm: str, name: str = TUNED, **changes: Any) -> Online[Any]:
    """The options of an online algorithm, with some replaced."""
    config = preset(algorithm, name)
    return Online(algorithm=algorithm, config=config, preset=name, **changes)


_CONTINUED = ("episodes", "patience")
"""What may be another when a run is resumed: more of it only continues. (The evaluation
at the former end stays, and counts.)"""


def check_online(options: Online[Any]) -> None:
    """Raise before any work is done for options that make no sense.

    Raises:
        UsageError: Naming the option.
    """
    check_positive(curve_episodes=options.curve_episodes)
    longest = make_task(options.task, options.overrides).max_steps
    if getattr(options.config, "capacity", longest) < longest:
        raise UsageError(
            f"--capacity is {options.config.capacity}, expected at least an episode's "
            f"{longest} steps"
        )
    ALGORITHMS.get(options.algorithm).check(options.config)


def check_online_run(
    options: Online[Any], seed: int, run: Path, further: bool = True
) -> None:
    """Raise before any work is done for what would stop a run; see ``check_run``.

    Args:
        options: How to learn.
        seed: Of the run.
        run: Its folder.
        further: Whether it may go on to more episodes than it was to have.
    """
    config = _run_config(options, _demonstrations(options), seed)
    continued = _CONTINUED if further else ()
    check_run(run, config, options, ("preset", "eval_episodes", *continued))
    if options.resume and (run / FILE).exists():
        _check_end(options, run)


def _check_end(options: Online[Any], run: Path) -> None:
    """Raise if a run cannot go on to the episodes asked for."""
    rows = read_metrics(run)
    done = rows[-1]["episode"] if rows else 0
    asked = options.config.episodes
    if done > asked:
        raise UsageError(f"{run} has {done} episodes already, --episodes is {asked}")
    patience = options.schedule.patience
    if asked != read_config(run).settings["episodes"] and is_flat(rows, patience):
        raise UsageError(
            f"{run} ended at episode {done}, as its success rate had been flat for "
            f"{patience}: --patience 0 goes on to --episodes {asked} all the same"
        )


def train_online_run(
    options: Online[Any], seed: int, run: Path
) -> tuple[Evaluation, Evaluation]:
    """Train one seed into a run folder; evaluations of its last and its best policy.

    Raises:
        DivergedError: If a loss is not finite; there may be a checkpoint from before.
    """
    check_online_run(options, seed, run)
    with only_here(run):
        _train(options, seed, run)
        return evaluate_online_run(options, run)


def evaluate_online_run(
    options: Online[Any], run: Path
) -> tuple[Evaluation, Evaluation]:
    """Draw a trained run's learning curve; evaluate its last and its best policy."""
    from marl_mm.eval.figures import online_curve  # matplotlib takes half a second

    online_curve(read_metrics(run), run / CURVE)
    with progress_bars() as bar:
        last, best = (
            evaluate_run(
                run, options, options.task, file, result, bar, label, options.overrides
            )
            for file, result, label in (
                (FILE, EVALUATION, "eval last"),
                (BEST, BEST_EVALUATION, "eval best"),
            )
        )
    return last, best


def _train(options: Online[Any], seed: int, run: Path) -> None:
    demonstrations = _demonstrations(options)
    task = make_task(options.task, options.overrides)
    algorithm: OnlineAlgorithm = ALGORITHMS.get(options.algorithm).learner(
        options.config,
        task,
        seed,
        demonstrations.episodes if demonstrations else (),
        task.layout,
    )
    if options.resume and (run / FILE).exists():
        resume(algorithm, run, ("episodes",))
        config = _run_config(options, demonstrations, seed)
        further = {name: config.settings[name] for name in _CONTINUED}
        continue_run(run, config.plugins, further)
    else:
        start_run(run, _run_config(options, demonstrations, seed))

    with Rollouts(task, options.workers) as rollouts:

        def run_episodes(policy: Explorer, numbers: Iterable[int]) -> Iterator[Episode]:
            plans = [EpisodePlan(i, episode_seed(seed, i, "train")) for i in numbers]
            return rollouts.run(policy, plans)

        def point(policy: LearnedPolicy) -> CurvePoint:
            goals = options.eval_seed + 1  # not those of the final evaluation
            count, overrides = options.curve_episodes, options.overrides
            return curve_point(
                evaluate_with(rollouts, policy, count, goals, options.task, overrides)
            )

        total = options.config.episodes
        with progress_bar(f"{algorithm.name} {seed}", total) as advance:
            train_online(algorithm, run, run_episodes, point, options.schedule, advance)


def _demonstrations(options: Online[Any]) -> Dataset | None:
    if not options.demonstrations:
        return None
    dataset = load_dataset(options.demonstrations)
    task = dataset.provenance.task
    if task != options.task:
        raise UsageError(
            f"--demonstrations {options.demonstrations} is of {task}, expected "
            f"{options.task}: their rewards differ"
        )
    return dataset


def _run_config(
    options: Online[Any], demonstrations: Dataset | None, seed: int
) -> RunConfig:
    """What a run is made of."""
    own = ("curve_episodes", "eval_episodes", "eval_seed")
    return RunConfig(
        algorithm=options.algorithm,
        preset=options.preset,
        seed=seed,
        task=options.task,
        dataset=demonstrations.identity() if demonstrations else None,
        packages=versions(),
        plugins=plugins_of(options.algorithm, options.task),
        settings={
            **options.overrides,
            **{name: getattr(options, name) for name in own},
            **asdict(options.schedule),
            **asdict(options.config),
        },
    )
