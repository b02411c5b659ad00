"""The training loop and the run folders it fills.

A run is a folder: ``config.json`` (written before the first step), ``metrics.jsonl``,
the files of the loggers, ``checkpoint.pt``, the policy of the learning curve's best
point in ``best.pt`` and, from the last evaluation, ``eval.json``.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from marl_mm.algorithms.algorithm import OfflineAlgorithm, Resumable
from marl_mm.algorithms.checkpoint import (
    BEST,
    DAMAGE,
    FILE,
    check_types,
    read_checkpoint,
    save_seed,
    save_seeds_policy,
)
from marl_mm.algorithms.loggers import DEFAULT_LOGGERS, Row
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.runlog import CurvePoint, RunLog, is_best
from marl_mm.algorithms.speed import matrix_products, small_networks
from marl_mm.config_diff import refuse_other_config
from marl_mm.declared import with_added
from marl_mm.errors import CheckpointError, DivergedError, UsageError
from marl_mm.interrupts import deaf_to_interrupts
from marl_mm.progress import Advance, silent

Evaluate = Callable[[LearnedPolicy], CurvePoint]
"""Evaluation of a policy; the loop knows nothing of environments."""

LOG_EVERY = 100
"""Updates per row of ``metrics.jsonl``, which has their means, and per checkpoint."""


@small_networks()
def train(
    algorithm: OfflineAlgorithm,
    runs: Sequence[Path],
    evaluate: Evaluate,
    evaluate_every: int,
    advance: Advance = silent,
    stop_diverging: bool = True,
    loggers: Sequence[str] = DEFAULT_LOGGERS,
) -> None:
    """Update until the config's number of updates, from wherever the algorithm stands.

    Args:
        algorithm: Fresh, or resumed by ``resume_seeds``.
        runs: The folder of each seed's run.
        evaluate: Evaluation of a policy, before the first update, every
            ``evaluate_every``-th and after the last.
        evaluate_every: Updates between evaluations.
        advance: Progress callback, called with updates.
        stop_diverging: Whether a metric beyond its bound stops the run, too.
        loggers: Names of the loggers beside ``metrics.jsonl``, see ``LOGGERS``.

    Raises:
        KeyboardInterrupt: After Ctrl-C, saying which checkpoint there is.
        DivergedError: If a logged metric is not finite or beyond its bound; the last
            checkpoint is left as it is.
        CheckpointError: If the rows are damaged, or end before the checkpoint.
        UsageError: If a logger is unknown or cannot start.
    """
    total, saved = algorithm.config.updates, algorithm.step
    advance(min(saved, total), "")
    with ExitStack() as stack:
        opened = (RunLog(run, "step", saved, loggers) for run in runs)
        logs = [stack.enter_context(log) for log in opened]

        def keep(step: int, rows: Sequence[Row]) -> None:
            with deaf_to_interrupts():  # all seeds at the same step
                for number, (log, row) in enumerate(zip(logs, rows, strict=True)):
                    log.add({"step": step, **row})
                    save_seed(log.run / FILE, algorithm, number)

        try:
            if saved == 0 and not all(log.rows for log in logs):
                points = _evaluate_seeds(algorithm, evaluate)
                _keep_best(algorithm, points, logs)
                keep(0, points)
            while saved < total:
                step = min(_after(saved, LOG_EVERY), _after(saved, evaluate_every))
                step = min(step, total)
                measured = update_to(algorithm, step) | algorithm.diagnose()
                refuse_divergence(algorithm, measured, stop_diverging)
                rows = rows_by_seed(algorithm, measured)
                if step % evaluate_every == 0 or step == total:
                    points = _evaluate_seeds(algorithm, evaluate)
                    rows = [a | b for a, b in zip(rows, points, strict=True)]
                    _keep_best(algorithm, rows, logs)
                keep(step, rows)
                done, saved = step - saved, step
                advance(done, _note(measured))
        except (KeyboardInterrupt, DivergedError) as error:
            begun = all((run / FILE).exists() for run in runs)
            kept = f"the checkpoint of update {saved}" if begun else "no checkpoint"
            where = f"{', '.join(map(str, runs))}: {kept}"
            if isinstance(error, DivergedError):
                raise DivergedError(f"{error}; {where}") from None
            again = "go on with `resume=True`"
            raise KeyboardInterrupt(f"stopped; {where}; {again}") from None


def _after(step: int, every: int) -> int:
    """Next multiple of ``every`` after a step."""
    return (step // every + 1) * every


def update_to(algorithm: OfflineAlgorithm, step: int) -> dict[str, torch.Tensor]:
    """Make updates up to number ``step``; means of their metrics, shape (S,).

    Raises:
        UsageError: If the algorithm does not count them.
    """
    sums: dict[str, torch.Tensor] = {}
    counts: dict[str, int] = {}
    with matrix_products(algorithm.config.precision):
        for made in range(algorithm.step + 1, step + 1):
            measured = algorithm.update()
            if algorithm.step != made:
                raise UsageError(
                    f"`step` of {algorithm.name} is {algorithm.step} after update "
                    f"{made}: `update` has to count it"
                )
            for key, value in measured.items():
                sums[key] = sums[key] + value if key in sums else value
                counts[key] = counts.get(key, 0) + 1
    return {key: value / counts[key] for key, value in sums.items()}


def refuse_divergence(
    algorithm: OfflineAlgorithm,
    measured: Mapping[str, torch.Tensor],
    stop_diverging: bool,
) -> None:
    """Raise for a metric that is not finite, or beyond its bound.

    Args:
        algorithm: Algorithm, with the bounds of its metrics.
        measured: Metrics by name, shape (S,).
        stop_diverging: Whether bounds count, too.

    Raises:
        DivergedError: Naming the metric.
    """
    limits = algorithm.bounds if stop_diverging else {}
    switches = "clip_targets", "layer_norm"
    bounded = all(hasattr(algorithm.config, name) for name in switches)
    advice = "leave on `clip_targets` and `layer_norm`, " if bounded else ""
    for key, values in measured.items():
        limit = limits.get(key, math.inf)
        for seed, value in zip(algorithm.seeds, values.tolist(), strict=True):
            finite = math.isfinite(value)
            if finite and abs(value) <= limit:
                continue
            excess = f", more than {limit:.3g}" if finite else ""
            raise DivergedError(
                f"{key} is {value:.3g}{excess} with seed {seed} after "
                f"{algorithm.step} updates: lower the learning rate, {advice}or look "
                "for odd values with marl-mm datasets verify"
            )


def _note(measured: Mapping[str, torch.Tensor]) -> str:
    """Mean losses over seeds, for the progress bar."""
    losses = {
        key: f"{value.mean().item():.3g}"
        for key, value in measured.items()
        if key.count("/") == 1 and key.startswith("loss/") and "imitation" not in key
    }
    networks = ("critic", "value", "conservative", "flow")
    shared = [name for name in networks if f"loss/{name}" in losses]
    parts = [f"{name} {losses.pop(f'loss/{name}')}" for name in shared]
    if losses:  # the agents', for whose names there is no room
        parts.append(f"actor {' '.join(losses.values())}")
    return ", ".join(parts)


def rows_by_seed(
    algorithm: OfflineAlgorithm, values: Mapping[str, torch.Tensor]
) -> list[Row]:
    """A row of metrics per seed."""
    lists = {key: value.tolist() for key, value in values.items()}
    return [
        {key: numbers[i] for key, numbers in lists.items()}
        for i in range(len(algorithm.seeds))
    ]


def _evaluate_seeds(algorithm: OfflineAlgorithm, evaluate: Evaluate) -> list[Row]:
    policies = (
        LearnedPolicy(algorithm.name, algorithm.agents(number), algorithm.layout)
        for number in range(len(algorithm.seeds))
    )
    return [dict(evaluate(policy)) for policy in policies]


def _keep_best(
    algorithm: OfflineAlgorithm, rows: Sequence[Row], logs: Sequence[RunLog]
) -> None:
    """Keep the policy of each seed whose evaluation is its best so far."""
    for number, (row, log) in enumerate(zip(rows, logs, strict=True)):
        if is_best(row, log.rows):
            save_seeds_policy(log.run / BEST, algorithm, number)


def resume(algorithm: Resumable, run: Path, ignored: Sequence[str] = ()) -> None:
    """Bring a fresh algorithm to a run's checkpoint.

    Args:
        algorithm: Fresh, with the run's config.
        run: The run's folder.
        ignored: Fields of the config that may differ.

    Raises:
        CheckpointError: If the run is of another algorithm.
        OtherConfigError: If it is of another config.
    """
    state = _state(algorithm, run, ignored)
    with _damage_named(run):
        check_types(state, algorithm.state())
        algorithm.load_state(state)


def resume_seeds(
    algorithm: OfflineAlgorithm, runs: Sequence[Path], ignored: Sequence[str] = ()
) -> None:
    """Bring a fresh offline algorithm to the checkpoints of its seeds' runs.

    Args:
        algorithm: Fresh, with the runs' config.
        runs: Folders of the runs.
        ignored: Fields of the config that may differ.

    Raises:
        CheckpointError: If a run is of another algorithm, or they stand at different
            updates.
        OtherConfigError: If one is of another config.
    """
    states = [_state(algorithm, run, ignored) for run in runs]
    steps = []
    for number, (run, state) in enumerate(zip(runs, states, strict=True)):
        with _damage_named(run):
            steps.append(int(state["step"]))
            check_types(state, algorithm.state(number))
    if len(set(steps)) > 1:
        raise CheckpointError(
            f"the runs stand at updates {', '.join(map(str, steps))}: resume them one "
            "by one"
        )
    with _damage_named(*runs):
        algorithm.load_states(states)


@contextmanager
def _damage_named(*runs: Path) -> Iterator[None]:
    """Turn errors of a state that does not fit into one that names the files."""
    try:
        yield
    except DAMAGE as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        files = " or ".join(str(run / FILE) for run in runs)
        raise CheckpointError(
            f"{files} is damaged ({reason:.80}): start anew with `overwrite=True`"
        ) from error


def _state(
    algorithm: Resumable | OfflineAlgorithm, run: Path, ignored: Sequence[str]
) -> dict[str, Any]:
    checkpoint = read_checkpoint(run, algorithm.name)
    current = asdict(algorithm.config)
    for name in ignored:
        del current[name]
    begun = with_added(checkpoint["config"], algorithm.config)
    refuse_other_config(run, begun, current)
    state: dict[str, Any] = checkpoint["state"]
    return state
