"""What training commands share: a run's folder, its config, its evaluation."""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, cast

from marl_mm.algorithms.checkpoint import BEST, FILE
from marl_mm.algorithms.export import POLICY_FORMATS
from marl_mm.algorithms.loggers import LOGGED
from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.registry import ALGORITHMS
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.algorithms.runlog import METRICS, CurvePoint
from marl_mm.commands.options import (
    check_positive,
    check_seed,
    check_seeds,
)
from marl_mm.commands.parser import with_values
from marl_mm.config_diff import as_json, refuse_other_config
from marl_mm.envs.registry import TASKS
from marl_mm.errors import (
    CheckpointError,
    OtherConfigError,
    OutputExistsError,
    UsageError,
)
from marl_mm.eval.evaluate import Evaluation, evaluate
from marl_mm.files import refuse_existing, write_json
from marl_mm.plugins import record
from marl_mm.progress import Bar
from marl_mm.workers import available_cores

T = TypeVar("T")

CONFIG = "config.json"
EVALUATION = "eval.json"
BEST_EVALUATION = "eval_best.json"
CURVE = "learning_curve.png"
SB3_BEST = "best.zip"

_MADE = ("eval*.json", *(f"*{one.suffix}" for _, one in POLICY_FORMATS.items()))
"""What is made of a run's policies: evaluations and exports."""


@dataclass(frozen=True)
class TrainOptions:
    """What every algorithm needs."""

    out: Path | None = None
    """Folder of the runs; seed s goes to OUT/s; default runs/ALGORITHM."""

    seeds: tuple[int, ...] = (0,)
    """One run each: initial weights, batches, episodes."""

    eval_episodes: int = 100
    """Goals of the evaluation after training, kept in eval.json."""

    eval_seed: int = 0
    """Of those goals; the learning curve has goals of its own, of the next seed."""

    max_steps: int | None = None
    """Steps of an episode, of evaluations too; default the task's: 25."""

    workers: int = field(default_factory=available_cores)
    """Processes that run episodes, and that train seeds from a dataset; the result does
    not depend on it."""

    resume: bool = False
    """Go on where runs were stopped; seeds that have none start. What is left out is as
    the first run in OUT has it."""

    allow_changed_plugin: bool = False
    """With --resume, go on though a plug-in is another file than before; the run's
    config keeps both hashes."""

    overwrite: bool = False
    """Start anew where a run exists."""

    json: bool = False
    """Print the final evaluations as JSON."""

    @property
    def overrides(self) -> dict[str, Any]:
        """Of the task's config."""
        return {} if self.max_steps is None else {"max_steps": self.max_steps}


def check_options(options: TrainOptions, out: Path) -> None:
    """Raise for options that make no sense, whatever the algorithm.

    Raises:
        UsageError: Naming the option.
    """
    check_positive(eval_episodes=options.eval_episodes, workers=options.workers)
    check_seed(options.eval_seed)
    check_seeds(options.seeds)
    if options.resume and options.overwrite:
        raise UsageError("--resume and --overwrite contradict each other: choose one")
    runs = [out / str(seed) / CONFIG for seed in options.seeds]
    if options.resume and (out / CONFIG).exists():
        raise UsageError(
            f"{out} is a run itself: --out {out.parent} --seeds {out.name} resumes it"
        )
    if options.resume and not any(run.exists() for run in runs):
        raise UsageError(f"no run in {out} to resume: leave out --resume to start")


def check_run(
    run: Path,
    config: RunConfig,
    options: TrainOptions,
    ignored: Sequence[str] = (),
) -> None:
    """Raise before any work is done for what would stop a run.

    Args:
        run: Its folder.
        config: What it will be made of.
        options: Whether it may be there already.
        ignored: Keys of the config in which a run that is resumed may differ.

    Raises:
        UsageError: If the run exists, or the one to resume is of another config.
    """
    if not options.resume:
        if (run / CONFIG).exists() and not options.overwrite:
            raise OutputExistsError(
                f"{run} exists already; go on with --resume, choose another --out or "
                "add --overwrite"
            )
        stopped_at_once = run.is_dir() and not any(run.iterdir())
        refuse_existing(run, options.overwrite or stopped_at_once)
        return
    if not ((run / FILE).exists() or (run / EVALUATION).exists()):
        return  # stopped before its first checkpoint, or before its turn
    _refuse_other_plugins(run, config, options.allow_changed_plugin)
    refuse_other(run, config, (*ignored, "plugins"))


def _refuse_other_plugins(run: Path, config: RunConfig, allowed: bool) -> None:
    """Raise if a plug-in is not the one that the run was made with, by whatever name.

    Raises:
        OtherConfigError: Naming it.
    """
    before, now = read_config(run).plugins, config.plugins
    if allowed or {*before.values()} == {*now.values()}:
        return
    for name in sorted({*before, *now}):
        if before.get(name) != now.get(name):
            raise OtherConfigError(
                f"{run} was made with another {name} (SHA-256 "
                f"{before.get(name, 'none'):.12}, now {now.get(name, 'none'):.12})",
                "go on with that file, or with --allow-changed-plugin",
            )


def refuse_other(run: Path, config: RunConfig, ignored: Sequence[str] = ()) -> None:
    """Raise if a run was made of something else than this config.

    Raises:
        OtherConfigError: Naming what differs.
        CheckpointError: If its config cannot be read.
    """
    theirs, mine = read_config(run).to_json(), as_json(config.to_json())
    for key in ("packages", *ignored):
        mine.pop(key, None)
    for one in (theirs, mine):  # a dataset may have moved
        if one.get("dataset"):
            one["dataset"].pop("path", None)
    refuse_other_config(run, theirs, mine)


def plugins_of(algorithm: str, task: str) -> dict[str, str]:
    """Hashes of the plug-ins that an algorithm and a task come from, if any."""
    return record(ALGORITHMS.origin(algorithm), TASKS.origin(task))


def start_run(run: Path, config: RunConfig) -> None:
    """A run folder with its config; what an older run left there goes."""
    run.mkdir(parents=True, exist_ok=True)
    _remove(run, FILE, BEST, METRICS, CURVE, SB3_BEST, *LOGGED, *_MADE)
    write_json(run / CONFIG, config.to_json())


def saved_options(options: T, out: Path) -> T:
    """Options with the values that the runs in a folder were made of, if there are any.

    Args:
        options: A dataclass of them, with others in it.
        out: The folder of the runs, one for each seed.

    Raises:
        CheckpointError: If the first run's config cannot be read.
    """
    runs = sorted(
        (run.parent for run in out.glob(f"*/{CONFIG}") if run.parent.name.isdecimal()),
        key=lambda run: int(run.name),
    )
    if not runs:
        return options
    config = read_config(runs[0]).to_json()
    dataset = (config["dataset"] or {}).get("path")
    seeds = [int(run.name) for run in runs]
    known = {"seeds": seeds, "dataset": dataset, "demonstrations": dataset}
    resumed: T = with_values(options, config | known)
    return resumed


def read_config(run: Path) -> RunConfig:
    """What a run is made of.

    Raises:
        CheckpointError: If it cannot be read.
    """
    try:
        return RunConfig.from_json(json.loads((run / CONFIG).read_text()))
    except (OSError, ValueError, AttributeError) as error:
        raise CheckpointError(f"cannot read {run / CONFIG}: {error}") from error


def continue_run(
    run: Path, plugins: Mapping[str, str], settings: Mapping[str, Any]
) -> None:
    """Note in a run's config which plug-ins and settings it goes on with."""
    config = read_config(run)
    further = config.continued(plugins, settings)
    if further != config:  # what was made of where it ended before goes
        _remove(run, *_MADE)
        write_json(run / CONFIG, further.to_json())


def _remove(run: Path, *patterns: str) -> None:
    for pattern in patterns:
        for path in run.glob(pattern):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def evaluate_run(
    run: Path,
    options: TrainOptions,
    task: str,
    checkpoint: str,
    result: str,
    bar: Bar,
    label: str,
    overrides: Mapping[str, Any],
) -> Evaluation:
    """Evaluate a trained run and keep the result beside it, unless that is there.

    With ``--resume``, one of as many goals of the same seed is not repeated;
    ``continue_run`` deletes those of a run that goes further.

    Raises:
        KeyboardInterrupt: After Ctrl-C, saying how to go on.
    """
    if options.resume and (run / result).exists():
        known = Evaluation.from_json(json.loads((run / result).read_text()))
        asked = (options.eval_episodes, options.eval_seed)
        if (len(known.rows), known.seed) == asked:
            return known
    policy = load_policy(run / checkpoint)
    try:
        evaluation = evaluate(
            policy,
            options.eval_episodes,
            options.eval_seed,
            task,
            overrides,
            workers=options.workers,
            advance=bar(label, options.eval_episodes),
        )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; {run} is trained: evaluate it with --resume"
        ) from None
    write_json(run / result, evaluation.to_json())
    return evaluation


def curve_point(evaluation: Evaluation) -> CurvePoint:
    """What a learning curve keeps of an evaluation."""
    point: dict[str, float] = {}
    for name, part in evaluation.summary.items():
        point[f"success/{name}"] = part["success_rate"]
        point[f"return/{name}"] = part["return"]
        if "alpha" in part:
            point[f"alpha/{name}"] = part["alpha"]
    return cast(CurvePoint, point)


def told(run: Path, evaluation: Evaluation, best: Evaluation | None = None) -> str:
    """One line about a run's success."""
    text = f"{run}: {_told(evaluation)}"
    return text if best is None else f"{text}; best checkpoint {_told(best)}"


def _told(evaluation: Evaluation) -> str:
    everything = evaluation.summary["all"]
    low, high = (100 * bound for bound in everything["interval"])
    return (
        f"{100 * evaluation.success_rate:.1f} % of {everything['episodes']} goals "
        f"reached, 95 % interval [{low:.1f}, {high:.1f}]"
    )
