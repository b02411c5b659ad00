"""Runs that learn from a dataset file."""

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from marl_mm.algorithms.algorithm import OfflineAlgorithm
from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.mabc import Mabc, MabcConfig
from marl_mm.algorithms.matd3_bc import Matd3Bc, Matd3BcConfig
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.presets import OfflineConfig, Preset, offline_preset
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.td3_bc import Td3Bc, Td3BcConfig
from marl_mm.algorithms.train import resume_seeds, train
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
from marl_mm.envs.terms import judge
from marl_mm.eval.evaluate import Evaluation, evaluate
from marl_mm.eval.figures import learning_curve
from marl_mm.files import only_here
from marl_mm.progress import progress_bar
from marl_mm.versions import versions


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


def offline_options(algorithm: str, name: Preset = "tuned", **changes: Any) -> Offline:
    """The options of an offline algorithm, with some replaced."""
    config: Any = offline_preset(algorithm, name)
    kinds: dict[str, Any] = {
        "mabc": TrainMabc,
        "td3-bc": TrainTd3Bc,
        "matd3-bc": TrainMatd3Bc,
    }
    options: Offline = kinds[algorithm](config=config, preset=name, **changes)
    return options


def check_offline(dataset: Dataset, options: Offline, seed: int, run: Path) -> None:
    """Raise before any work is done for what would stop a run; see ``check_run``."""
    check_positive(
        curve_every=options.curve_every, curve_episodes=options.curve_episodes
    )
    config = _run_config(dataset, options, seed)
    reach_config(config["task"])
    check_run(run, config, options, ("preset",))


def train_offline(
    dataset: Dataset, options: Offline, seed: int, run: Path
) -> Evaluation:
    """Train one seed, evaluate it, and leave a run folder.

    Raises:
        DivergedError: If a loss is not finite; there may be a checkpoint from before.
    """
    check_offline(dataset, options, seed, run)
    with only_here(run):
        _train(dataset, options, seed, run)
        task = _run_config(dataset, options, seed)["task"]
        return evaluate_run(run, options, task, FILE, EVALUATION)


def _train(dataset: Dataset, options: Offline, seed: int, run: Path) -> None:
    config = _run_config(dataset, options, seed)
    algorithm = _algorithm(dataset, options.config, seed)
    if options.resume and (run / FILE).exists():
        resume_seeds(algorithm, [run])
    else:
        start_run(run, config)

    def point(policy: LearnedPolicy) -> dict[str, float]:
        goals = options.eval_seed + 1  # not those of the final evaluation
        return curve_point(
            evaluate(policy, options.curve_episodes, goals, config["task"])
        )

    total = options.config.updates
    with progress_bar(f"{algorithm.name} {seed}", total) as advance:
        train(algorithm, [run], point, options.curve_every, advance)
    learning_curve(read_metrics(run), run / CURVE)


def _algorithm(dataset: Dataset, config: OfflineConfig, seed: int) -> OfflineAlgorithm:
    task = reach_config(dataset.metadata["marl_mm"]["task"])
    rewards = partial(judge, config=task)
    if isinstance(config, MabcConfig):
        return Mabc(config, dataset.arrays, rewards, [seed])
    if isinstance(config, Matd3BcConfig):
        return Matd3Bc(config, dataset.arrays, rewards, [seed])
    return Td3Bc(config, dataset.arrays, rewards, [seed])


def _run_config(dataset: Dataset, options: Offline, seed: int) -> dict[str, Any]:
    """What a run is made of; ``config.json``."""
    names = {MabcConfig: "mabc", Td3BcConfig: "td3-bc", Matd3BcConfig: "matd3-bc"}
    return {
        "algorithm": names[type(options.config)],
        "preset": options.preset,
        "seed": seed,
        "task": options.task or dataset.metadata["marl_mm"]["task"],
        "dataset": dataset.identity(),
        "packages": versions(),
        **asdict(options.config),
    }
