"""What stops runs before any work is done."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from marl_mm.algorithms.fine_tuning import FineTuning
from marl_mm.algorithms.offline_batches import refuse_missing_terms, refuse_odd_values
from marl_mm.algorithms.online import is_flat
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, preset
from marl_mm.algorithms.runlog import METRICS, MOST_ROWS, read_metrics
from marl_mm.algorithms.train import LOG_EVERY
from marl_mm.datasets.dataset import Dataset
from marl_mm.envs.registry import make_task
from marl_mm.errors import DatasetError, UsageError
from marl_mm.layout_diff import refuse_other_layout
from marl_mm.runs.folder import (
    check_run,
    goes_on,
    read_config,
    run_config,
    task_of,
)
from marl_mm.runs.learning import algorithm_of
from marl_mm.runs.settings import check_positive
from marl_mm.runs.starts import check_start
from marl_mm.runs.training import Offline, Online, Training
from marl_mm.sim.config import default_engine
from marl_mm.sim.world import check_engine
from marl_mm.workers import check_workers


def check_training(
    training: Training,
    dataset: Dataset | None,
    runs: Mapping[int, Path],
    further: bool = True,
) -> None:
    """Raise before any work is done for what would stop runs.

    Args:
        training: Settings of the runs.
        dataset: Dataset to learn from, or to replay online, if any.
        runs: Folders by seed.
        further: Whether runs may go on further than they were to go.

    Raises:
        UsageError: If a setting makes no sense or a run exists.
        DatasetError: If there is nothing to learn from.
        OtherConfigError: If a run to resume was made otherwise.
    """
    check_positive(curve_episodes=training.curve_episodes)
    check_workers(training.workers)
    ALGORITHMS.get(training.algorithm).check(training.config)
    make_task(task_of(training, dataset), training.overrides)
    fresh = not all(goes_on(run, training) for run in runs.values())
    if isinstance(training, Offline):
        assert dataset is not None
        _check_offline(training, dataset, fresh)
    else:
        _check_online(training, dataset, fresh)
    for seed, run in runs.items():
        config = run_config(training, dataset, seed)
        check_run(run, config, training, further)
        if goes_on(run, training):
            _check_end(training, run)
        elif isinstance(training, Offline) and training.start is not None:
            check_start(training, config, run)
    check_engine(training.engine or default_engine())
    if isinstance(training, Offline):  # refuses what it cannot learn from
        algorithm = algorithm_of(training, dataset, list(runs))
        members = (hasattr(algorithm, name) for name in ("own", "observe"))
        if training.fine_tuning.online_steps and not all(members):
            raise UsageError(
                f"{algorithm.name} learns from a dataset only, as it has no `own` and "
                "`observe`: expected `online_steps` 0"
            )


def _check_offline(training: Offline, dataset: Dataset, fresh: bool) -> None:
    check_positive(curve_every=training.curve_every)
    online_steps = training.fine_tuning.online_steps
    updates = training.config.updates
    rows = updates // LOG_EVERY + updates // training.curve_every
    if rows > MOST_ROWS:
        raise UsageError(
            f"`updates` is {updates:,} and `curve_every` {training.curve_every:,}, "
            f"which make {rows:,} rows of {METRICS}, expected at most {MOST_ROWS:,}"
        )
    if updates + online_steps == 0:
        raise UsageError(
            f"`updates` is 0 and `online_steps` too, expected one of them > 0: "
            f"{training.algorithm} has nothing to learn from otherwise"
        )
    if fresh and not online_steps:
        _refuse_unused(training.fine_tuning, FineTuning(), "`online_steps` is 0")
    name, arrays = dataset.location.name, dataset.arrays
    if training.require_success and fresh and not arrays.successes().any():
        others = " (and `imitate` all)" if hasattr(training.config, "imitate") else ""
        raise DatasetError(
            f"none of the {len(arrays)} episodes of {name} reaches its goal, so that "
            "there is no success to learn from; with `require_success=False`"
            f"{others} it is tried all the same"
        )
    task = task_of(training, dataset)
    refuse_other_layout(name, arrays.layout, task, make_task(task).layout)
    if online_steps and task != dataset.provenance.task:
        raise UsageError(
            f"{name} is of {dataset.provenance.task}, expected {task} with "
            "`online_steps`: their rewards differ"
        )


def _refuse_unused(
    given: Any, usual: Any, why: str, names: Sequence[str] | None = None
) -> None:
    """Raise for a setting that was changed though it has no effect."""
    for name in names or [field.name for field in fields(usual)]:
        value, other = (getattr(of, name, None) for of in (given, usual))
        if value != other:
            raise UsageError(
                f"`{name}` is {value}, but {why}, so that it has no effect: leave it "
                f"at {other}"
            )


def _check_online(
    training: Training, demonstrations: Dataset | None, fresh: bool
) -> None:
    assert isinstance(training, Online)
    task = make_task(training.task, training.overrides)
    longest = task.max_steps
    if getattr(training.config, "capacity", longest) < longest:
        raise UsageError(
            f"`capacity` is {training.config.capacity}, expected at least an episode's "
            f"{longest} steps"
        )
    weight = getattr(training.config, "imitation_weight", 0.0)
    if weight and demonstrations is None:
        raise UsageError(
            f"`imitation_weight` is {weight}, but there are no `demonstrations`: name "
            "a dataset, or leave it at 0"
        )
    if demonstrations is None:
        usual = preset(training.algorithm, training.preset or TUNED)
        names = "demonstration_share", "demonstration_successes"
        if fresh:
            why = "there are no `demonstrations`"
            _refuse_unused(training.config, usual, why, names)
        return
    size = getattr(training.config, "batch_size", 0)
    share = getattr(training.config, "demonstration_share", 1.0)
    if size and round(share * size) == 0:
        raise UsageError(
            f"`demonstration_share` is {share} of {size}: no transition of a batch is "
            "a demonstration; raise it, or leave out `demonstrations`"
        )
    name, arrays = demonstrations.location.name, demonstrations.arrays
    if demonstrations.provenance.task != training.task:
        raise UsageError(
            f"`demonstrations` {name} is of {demonstrations.provenance.task}, expected "
            f"{training.task}: their rewards differ"
        )
    refuse_other_layout(name, arrays.layout, training.task, task.layout)
    refuse_odd_values(arrays)
    if getattr(training.config, "hindsight", 0):
        without = training.algorithm.removesuffix("-her")
        way_out = f"take {without}, without hindsight, or leave `demonstrations` out"
        refuse_missing_terms(arrays, task.needs, way_out)


def _check_end(training: Training, run: Path) -> None:
    """Raise if a run cannot go on to the updates or episodes asked for."""
    rows, clock = read_metrics(run, training.counter), training.clock
    own = [row for row in rows if "env_steps" in row and clock == "updates"]
    rows = rows[: len(rows) - len(own)]
    done = rows[-1][training.counter] if rows else 0
    asked = getattr(training.config, clock)
    if done > asked:
        raise UsageError(f"{run} has {done} {clock} already, `{clock}` is {asked}")
    before = read_config(run).settings
    if isinstance(training, Offline) and own:
        steps = before["online_steps"], training.fine_tuning.online_steps
        if steps[1] < steps[0]:
            raise UsageError(
                f"`online_steps` is {steps[1]}, but {run} was to take {steps[0]}: "
                "expected as many, or more"
            )
    if asked == before[clock]:
        return
    if own:
        raise UsageError(
            f"{run} has gone on online after {done} updates, `updates` is {asked}: "
            "expected as many; `online_steps` may grow"
        )
    if getattr(training.config, "q_weight_end", None) is not None:
        raise UsageError(
            f"{run} was to end at {before[clock]} updates, and `q_weight_end` with it: "
            f"`updates` {asked} needs a run of its own"
        )
    patience = training.schedule.patience if isinstance(training, Online) else 0
    if is_flat(rows, patience):
        raise UsageError(
            f"{run} ended at episode {done}, as its success rate had been flat for "
            f"{patience}: `patience` 0 goes on to `episodes` {asked} all the same"
        )
