"""marl-mm train: a policy from a dataset file, with its learning curve."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.mabc import Mabc, MabcConfig
from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.algorithms.train import (
    read_metrics,
    refuse_difference,
    resume,
    train,
)
from marl_mm.commands.options import available_cores, check_positive, check_seed
from marl_mm.commands.parser import parse_subcommand
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.envs.config import reach_config
from marl_mm.errors import CheckpointError, UsageError
from marl_mm.eval.evaluate import Evaluation, evaluate
from marl_mm.eval.figures import learning_curve
from marl_mm.files import refuse_existing, write_json
from marl_mm.progress import progress_bar
from marl_mm.versions import versions


@dataclass(frozen=True)
class TrainOptions:
    """What every algorithm needs."""

    dataset: str
    """Id, such as marl_mm/reach/pd-v0, or path."""

    out: Path = Path("runs/mabc")
    """Folder of the runs; seed s goes to OUT/s."""

    seeds: tuple[int, ...] = (0,)
    """One run each: initial weights and batches."""

    task: str | None = None
    """To evaluate on: Reach-v0, SmoothReach-v0 or PreciseReach-v0; default that of the
    dataset."""

    curve_every: int = 2_000
    """Updates between points of the learning curve."""

    curve_episodes: int = 20
    """Goals per point of the learning curve."""

    eval_episodes: int = 100
    """Goals of the evaluation after training, kept in eval.json."""

    eval_seed: int = 0
    """Of the goals."""

    workers: int = field(default_factory=available_cores)
    """Processes that evaluate."""

    resume: bool = False
    """Go on where runs were stopped; seeds that have none start."""

    overwrite: bool = False
    """Start anew where a run exists."""

    json: bool = False
    """Print the final evaluations as JSON."""


@dataclass(frozen=True)
class TrainMabc(TrainOptions):
    """Behaviour cloning with two decentralised actors (paper, Sec. 4.4)."""

    config: Annotated[MabcConfig, tyro.conf.arg(name="")] = field(
        default_factory=MabcConfig
    )


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm train``."""
    options = parse_subcommand(
        {"mabc": TrainMabc},
        "marl-mm train",
        "Train a policy from a dataset file.",
        arguments,
    )
    dataset = load_dataset(options.dataset)
    runs = {seed: options.out / str(seed) for seed in options.seeds}
    if not runs:
        raise UsageError("--seeds names no seed, expected at least one")
    if options.resume and not any((run / FILE).exists() for run in runs.values()):
        raise UsageError(f"no checkpoint in {options.out} to resume from")
    for seed, run in runs.items():
        check_run(dataset, options, seed, run)
    results = []
    for seed, run in runs.items():
        evaluation = train_run(dataset, options, seed, run)
        results.append({"run": str(run), **evaluation.to_json()})
        if not options.json:
            everything = evaluation.summary["all"]
            low, high = (100 * bound for bound in everything["interval"])
            print(
                f"{run}: {100 * evaluation.success_rate:.1f} % of "
                f"{everything['episodes']} goals reached, "
                f"95 % interval [{low:.1f}, {high:.1f}]"
            )
    if options.json:
        print(json.dumps(results, indent=2))


def check_run(dataset: Dataset, options: TrainMabc, seed: int, run: Path) -> None:
    """Raise before any work is done for what would stop a run.

    Raises:
        UsageError: If an option makes no sense, or the run exists.
        CheckpointError: If the run to resume was made with something else.
    """
    check_positive(
        curve_every=options.curve_every,
        curve_episodes=options.curve_episodes,
        eval_episodes=options.eval_episodes,
        workers=options.workers,
    )
    check_seed(seed, options.eval_seed)
    config = _run_config(dataset, options, seed)
    reach_config(config["task"])
    if not options.resume:
        refuse_existing(run, options.overwrite)
        return
    if not (run / FILE).exists():
        return  # stopped before its first checkpoint, or before its turn
    try:
        theirs = json.loads((run / "config.json").read_text())
    except (OSError, ValueError) as error:
        raise CheckpointError(f"cannot read {run / 'config.json'}: {error}") from error
    mine = json.loads(json.dumps(config))
    del mine["packages"], mine["dataset"]["path"]
    theirs["dataset"].pop("path", None)
    refuse_difference(run, theirs, mine)


def train_run(dataset: Dataset, options: TrainMabc, seed: int, run: Path) -> Evaluation:
    """Train one seed, evaluate it, and leave a run folder; see ``check_run``."""
    check_run(dataset, options, seed, run)
    config = _run_config(dataset, options, seed)
    task: str = config["task"]
    algorithm = Mabc(options.config, dataset.agents(), seed)
    if options.resume and (run / FILE).exists():
        resume(algorithm, run)
    else:
        _start_run(run, config)

    def point(policy: LearnedPolicy) -> dict[str, float]:
        goals = options.eval_seed + 1  # not those of the final evaluation
        summary = evaluate(policy, options.curve_episodes, goals, task).summary
        return {
            f"success/{name}": part["success_rate"] for name, part in summary.items()
        }

    total = options.config.updates
    with progress_bar(f"train {algorithm.name}", total) as advance:
        train(algorithm, run, point, options.curve_every, advance)
    learning_curve(read_metrics(run), run / "learning_curve.png")
    try:
        with progress_bar(f"eval {algorithm.name}", options.eval_episodes) as advance:
            evaluation = evaluate(
                load_policy(run),
                options.eval_episodes,
                options.eval_seed,
                task,
                workers=options.workers,
                advance=advance,
            )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; {run} is trained: evaluate it with --resume"
        ) from None
    write_json(run / "eval.json", evaluation.to_json())
    return evaluation


def _run_config(dataset: Dataset, options: TrainMabc, seed: int) -> dict[str, Any]:
    """What a run is made of; ``config.json``."""
    return {
        "algorithm": Mabc.name,
        "seed": seed,
        "task": options.task or dataset.metadata["marl_mm"]["task"],
        "dataset": {
            "id": dataset.metadata["dataset_id"],
            "path": str(dataset.location.folder),
            "fingerprint": dataset.fingerprint,
        },
        "packages": versions(),
        **asdict(options.config),
    }


def _start_run(run: Path, config: dict[str, Any]) -> None:
    """A run folder with its config; what an older run left there goes."""
    run.mkdir(parents=True, exist_ok=True)
    for name in (FILE, "metrics.jsonl", "eval.json", "learning_curve.png"):
        (run / name).unlink(missing_ok=True)
    write_json(run / "config.json", config)
