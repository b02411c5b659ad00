"""Runs that learn from a dataset file."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.mabc import Mabc, MabcConfig
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.train import resume, train
from marl_mm.commands.options import check_positive
from marl_mm.commands.runs import (
    CURVE,
    EVALUATION,
    TrainOptions,
    check_run,
    curve_point,
    evaluate_run,
    start_run,
)
from marl_mm.datasets.dataset import Dataset
from marl_mm.envs.config import reach_config
from marl_mm.eval.evaluate import Evaluation, evaluate
from marl_mm.eval.figures import learning_curve
from marl_mm.files import only_here
from marl_mm.progress import progress_bar
from marl_mm.versions import versions


@dataclass(frozen=True, kw_only=True)
class TrainOffline(TrainOptions):
    """What every offline algorithm needs."""

    dataset: str
    """Id, such as marl_mm/reach/pd-v0, or path."""

    task: str | None = None
    """To evaluate on: Reach-v0, SmoothReach-v0 or PreciseReach-v0; default that of the
    dataset."""

    curve_every: int = 2_000
    """Updates between points of the learning curve."""

    curve_episodes: int = 20
    """Goals per point of the learning curve."""


@dataclass(frozen=True, kw_only=True)
class TrainMabc(TrainOffline):
    """Behaviour cloning with two decentralised actors (paper, Sec. 4.4)."""

    config: Annotated[MabcConfig, tyro.conf.arg(name="")] = field(
        default_factory=MabcConfig
    )


def check_offline(dataset: Dataset, options: TrainMabc, seed: int, run: Path) -> None:
    """Raise before any work is done for what would stop a run; see ``check_run``."""
    check_positive(
        curve_every=options.curve_every, curve_episodes=options.curve_episodes
    )
    config = _run_config(dataset, options, seed)
    reach_config(config["task"])
    check_run(run, config, options)


def train_offline(
    dataset: Dataset, options: TrainMabc, seed: int, run: Path
) -> Evaluation:
    """Train one seed, evaluate it, and leave a run folder."""
    check_offline(dataset, options, seed, run)
    with only_here(run):
        _train(dataset, options, seed, run)
        task = _run_config(dataset, options, seed)["task"]
        return evaluate_run(run, options, task, FILE, EVALUATION)


def _train(dataset: Dataset, options: TrainMabc, seed: int, run: Path) -> None:
    config = _run_config(dataset, options, seed)
    algorithm = Mabc(options.config, dataset.agents(), seed)
    if options.resume and (run / FILE).exists():
        resume(algorithm, run)
    else:
        start_run(run, config)

    def point(policy: LearnedPolicy) -> dict[str, float]:
        goals = options.eval_seed + 1  # not those of the final evaluation
        return curve_point(
            evaluate(policy, options.curve_episodes, goals, config["task"])
        )

    total = options.config.updates
    with progress_bar(f"train {algorithm.name}", total) as advance:
        train(algorithm, run, point, options.curve_every, advance)
    learning_curve(read_metrics(run), run / CURVE)


def _run_config(dataset: Dataset, options: TrainMabc, seed: int) -> dict[str, Any]:
    """What a run is made of; ``config.json``."""
    return {
        "algorithm": Mabc.name,
        "seed": seed,
        "task": options.task or dataset.metadata["marl_mm"]["task"],
        "dataset": dataset.identity(),
        "packages": versions(),
        **asdict(options.config),
    }
