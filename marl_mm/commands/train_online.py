"""Runs that learn from episodes of their own."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from marl_mm.algorithms.checkpoint import BEST, FILE
from marl_mm.algorithms.ddpg import Ddpg, DdpgConfig
from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.maddpg import Maddpg, MaddpgConfig
from marl_mm.algorithms.online import Schedule, is_flat, train_online
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.presets import Preset, preset
from marl_mm.algorithms.runlog import read_metrics
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
    read_config,
    start_run,
)
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.envs.config import reach_config
from marl_mm.envs.rollout import EpisodePlan, Rollouts, episode_seed
from marl_mm.envs.terms import judge
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import Evaluation, evaluate_with
from marl_mm.files import only_here
from marl_mm.progress import progress_bar, progress_bars
from marl_mm.versions import versions


@dataclass(frozen=True, kw_only=True)
class TrainOnline(TrainOptions):
    """What every online algorithm needs."""

    task: Annotated[str, tyro.conf.arg(help=f"To learn: {REGISTERED}.")] = "Reach-v0"

    preset: Preset = "tuned"
    """Hyper-parameters that the defaults below are of: ours, or the paper's Table 2."""

    demonstrations: str | None = None
    """Dataset, id or path, whose episodes are replayed, too."""

    curve_episodes: int = 50
    """Goals per point of the learning curve."""

    schedule: Annotated[Schedule, tyro.conf.arg(name="")] = field(
        default_factory=Schedule
    )


@dataclass(frozen=True, kw_only=True)
class TrainDdpg(TrainOnline):
    """One agent that sees and sets everything (paper, Algorithm 1)."""

    config: Annotated[DdpgConfig, tyro.conf.arg(name="")]


@dataclass(frozen=True, kw_only=True)
class TrainMaddpg(TrainDdpg):
    """Two decentralised actors, one centralised critic (Lowe 2017)."""

    config: Annotated[MaddpgConfig, tyro.conf.arg(name="")]


ONLINE = {
    "ddpg": "DDPG: one agent that sees and sets everything (paper, Algorithm 1).",
    "ddpg-her": "DDPG that replays most steps with goals reached later (HER).",
    "maddpg": "MADDPG: two decentralised actors, one centralised critic (Lowe 2017).",
    "maddpg-her": "MADDPG that replays most steps with goals reached later (HER).",
}
"""Algorithms, and what helps say of them."""


def online_options(algorithm: str, name: Preset = "tuned", **changes: Any) -> TrainDdpg:
    """The options of an online algorithm, with some replaced."""
    config = preset(algorithm, name)
    if isinstance(config, MaddpgConfig):
        return TrainMaddpg(config=config, preset=name, **changes)
    return TrainDdpg(config=config, preset=name, **changes)


_CONTINUED = ("episodes", "patience")
"""What may be another when a run is resumed: more of it only continues. (The evaluation
at the former end stays, and counts.)"""


def check_online(algorithm: str, options: TrainDdpg) -> None:
    """Raise before any work is done for options that make no sense.

    Raises:
        UsageError: Naming the option.
    """
    check_positive(curve_episodes=options.curve_episodes)
    longest = reach_config(options.task, options.overrides).max_steps
    if options.config.capacity < longest:
        raise UsageError(
            f"--capacity is {options.config.capacity}, expected at least an episode's "
            f"{longest} steps"
        )
    hindsight = options.config.hindsight
    if (hindsight > 0) != algorithm.endswith("-her"):
        other = algorithm.removesuffix("-her") + "-her" * (hindsight > 0)
        raise UsageError(f"--hindsight is {hindsight} with {algorithm}: use {other}")


def check_online_run(
    options: TrainDdpg, seed: int, run: Path, further: bool = True
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


def _check_end(options: TrainDdpg, run: Path) -> None:
    """Raise if a run cannot go on to the episodes asked for."""
    rows = read_metrics(run)
    done = rows[-1]["episode"] if rows else 0
    asked = options.config.episodes
    if done > asked:
        raise UsageError(f"{run} has {done} episodes already, --episodes is {asked}")
    patience = options.schedule.patience
    if asked != read_config(run)["episodes"] and is_flat(rows, patience):
        raise UsageError(
            f"{run} ended at episode {done}, as its success rate had been flat for "
            f"{patience}: --patience 0 goes on to --episodes {asked} all the same"
        )


def train_online_run(
    options: TrainDdpg, seed: int, run: Path
) -> tuple[Evaluation, Evaluation]:
    """Train one seed into a run folder; evaluations of its last and its best policy.

    Raises:
        DivergedError: If a loss is not finite; there may be a checkpoint from before.
    """
    check_online_run(options, seed, run)
    with only_here(run):
        _train(options, seed, run)
        return evaluate_online_run(options, run)


def evaluate_online_run(options: TrainDdpg, run: Path) -> tuple[Evaluation, Evaluation]:
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


def _train(options: TrainDdpg, seed: int, run: Path) -> None:
    demonstrations = _demonstrations(options)
    task = reach_config(options.task, options.overrides)
    kind = Maddpg if isinstance(options.config, MaddpgConfig) else Ddpg
    algorithm = kind(
        options.config,
        partial(judge, config=task),
        seed,
        demonstrations.episodes if demonstrations else (),
        task.layout,
    )
    if options.resume and (run / FILE).exists():
        resume(algorithm, run, ("episodes",))
        config = _run_config(options, demonstrations, seed)
        continue_run(run, {name: config[name] for name in _CONTINUED})
    else:
        start_run(run, _run_config(options, demonstrations, seed))

    with Rollouts(task, options.workers) as rollouts:

        def run_episodes(policy: Explorer, numbers: Iterable[int]) -> Iterator[Episode]:
            plans = [EpisodePlan(i, episode_seed(seed, i, "train")) for i in numbers]
            return rollouts.run(policy, plans)

        def point(policy: LearnedPolicy) -> dict[str, float]:
            goals = options.eval_seed + 1  # not those of the final evaluation
            count, overrides = options.curve_episodes, options.overrides
            return curve_point(
                evaluate_with(rollouts, policy, count, goals, options.task, overrides)
            )

        total = options.config.episodes
        with progress_bar(f"{algorithm.name} {seed}", total) as advance:
            train_online(algorithm, run, run_episodes, point, options.schedule, advance)


def _demonstrations(options: TrainOnline) -> Dataset | None:
    if not options.demonstrations:
        return None
    dataset = load_dataset(options.demonstrations)
    task = dataset.metadata["marl_mm"]["task"]
    if task != options.task:
        raise UsageError(
            f"--demonstrations {options.demonstrations} is of {task}, expected "
            f"{options.task}: their rewards differ"
        )
    return dataset


def _run_config(
    options: TrainDdpg, demonstrations: Dataset | None, seed: int
) -> dict[str, Any]:
    """What a run is made of; ``config.json``."""
    base = "maddpg" if isinstance(options.config, MaddpgConfig) else "ddpg"
    return {
        "algorithm": base + "-her" * (options.config.hindsight > 0),
        "preset": options.preset,
        "seed": seed,
        "task": options.task,
        **options.overrides,
        "dataset": demonstrations.identity() if demonstrations else None,
        "curve_episodes": options.curve_episodes,
        "eval_episodes": options.eval_episodes,
        "eval_seed": options.eval_seed,
        "packages": versions(),
        **asdict(options.schedule),
        **asdict(options.config),
    }
