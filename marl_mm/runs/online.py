"""A run that learns from episodes of its own."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path

from marl_mm.algorithms.checkpoint import BEST, FILE
from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.online import OnlineAlgorithm, is_flat, train_online
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.train import resume
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import EpisodePlan, Rollouts, episode_seed
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.files import only_here
from marl_mm.progress import Bar
from marl_mm.runs.folder import (
    BEST_EVALUATION,
    CURVE,
    EVALUATED,
    EVALUATION,
    check_run,
    continue_run,
    curve,
    evaluate_run,
    read_config,
    run_config,
    start_run,
)
from marl_mm.runs.settings import check_positive
from marl_mm.runs.training import Online

_CONTINUED = ("episodes", "patience")
"""Settings of a run that may grow when it is resumed: more of it only continues. (The
evaluation at the former end stays, and counts.)"""


def check_online(training: Online) -> None:
    """Raise before any work is done for options that make no sense.

    Raises:
        UsageError: Naming the option.
    """
    check_positive(curve_episodes=training.curve_episodes)
    longest = make_task(training.task, training.overrides).max_steps
    if getattr(training.config, "capacity", longest) < longest:
        raise UsageError(
            f"`capacity` is {training.config.capacity}, expected at least an episode's "
            f"{longest} steps"
        )
    ALGORITHMS.get(training.algorithm).check(training.config)


def check_online_run(
    training: Online, seed: int, run: Path, further: bool = True
) -> None:
    """Raise before any work is done for what would stop a run; see ``check_run``.

    Args:
        training: Settings of the run.
        seed: Seed of the run.
        run: Folder of the run.
        further: Whether the run may go on to more episodes than it began with.
    """
    config = _run_config(training, _demonstrations(training), seed)
    continued = _CONTINUED if further else ()
    check_run(run, config, training, ("preset", "eval_episodes", *continued))
    if training.resume and (run / FILE).exists():
        _check_end(training, run)


def _check_end(training: Online, run: Path) -> None:
    """Raise if a run cannot go on to the episodes asked for."""
    rows = read_metrics(run)
    done = rows[-1]["episode"] if rows else 0
    asked = training.config.episodes
    if done > asked:
        raise UsageError(f"{run} has {done} episodes already, `episodes` is {asked}")
    patience = training.schedule.patience
    if asked != read_config(run).settings["episodes"] and is_flat(rows, patience):
        raise UsageError(
            f"{run} ended at episode {done}, as its success rate had been flat for "
            f"{patience}: `patience` 0 goes on to `episodes` {asked} all the same"
        )


def train_online_run(training: Online, seed: int, run: Path, bar: Bar) -> None:
    """Train one seed into a run folder; evaluate its last and its best policy.

    Raises:
        DivergedError: If a loss is not finite; there may be a checkpoint from before.
    """
    check_online_run(training, seed, run)
    with only_here(run):
        _train(training, seed, run, bar)
        evaluate_online_run(training, run, bar)


def evaluate_online_run(training: Online, run: Path, bar: Bar) -> None:
    """Draw a trained run's learning curve; evaluate its last and its best policy."""
    from marl_mm.eval.figures import online_curve  # matplotlib takes half a second

    online_curve(read_metrics(run), run / CURVE)
    task, overrides = training.task, training.overrides
    for file, result, label in (
        (FILE, EVALUATION, "eval last"),
        (BEST, BEST_EVALUATION, "eval best"),
    ):
        evaluate_run(run, training, task, file, result, bar, label, overrides)


def _train(training: Online, seed: int, run: Path, bar: Bar) -> None:
    demonstrations = _demonstrations(training)
    task = make_task(training.task, training.overrides)
    algorithm: OnlineAlgorithm = ALGORITHMS.get(training.algorithm).learner(
        training.config,
        task,
        seed,
        demonstrations.episodes if demonstrations else (),
        task.layout,
    )
    if training.resume and (run / FILE).exists():
        resume(algorithm, run, ("episodes",))
        config = _run_config(training, demonstrations, seed)
        further = {name: config.settings[name] for name in _CONTINUED}
        continue_run(run, config.plugins, further)
    else:
        start_run(run, _run_config(training, demonstrations, seed))

    with Rollouts(task, training.workers) as rollouts:

        def run_episodes(policy: Explorer, numbers: Iterable[int]) -> Iterator[Episode]:
            plans = [EpisodePlan(i, episode_seed(seed, i, "train")) for i in numbers]
            return rollouts.run(policy, plans)

        advance = bar(f"{algorithm.name} {seed}", training.config.episodes)
        train_online(
            algorithm,
            run,
            run_episodes,
            curve(rollouts, training, training.task),
            training.schedule,
            advance,
            training.logger,
        )


def _demonstrations(training: Online) -> Dataset | None:
    if not training.demonstrations:
        return None
    dataset = load_dataset(training.demonstrations)
    task = dataset.provenance.task
    if task != training.task:
        raise UsageError(
            f"`demonstrations` {training.demonstrations} is of {task}, expected "
            f"{training.task}: their rewards differ"
        )
    return dataset


def _run_config(
    training: Online, demonstrations: Dataset | None, seed: int
) -> RunConfig:
    """The record of a run."""
    own = {name: getattr(training, name) for name in ("curve_episodes", *EVALUATED)}
    settings = {**training.overrides, **own, **asdict(training.schedule)}
    return run_config(training, seed, training.task, demonstrations, settings)
