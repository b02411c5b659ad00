"""The training loop and the run folder it fills.

A run is a folder: ``config.json`` (written before the first step), ``metrics.jsonl``,
``checkpoint.pt`` and, from the last evaluation, ``eval.json``.
"""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from marl_mm.algorithms.algorithm import Algorithm
from marl_mm.algorithms.checkpoint import FILE, read_checkpoint, save_checkpoint
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.errors import CheckpointError
from marl_mm.files import new_file
from marl_mm.progress import Advance, silent

Evaluate = Callable[[LearnedPolicy], dict[str, float]]
"""Measures a policy; the loop knows nothing of environments."""

LOG_EVERY = 100
"""Most updates whose mean is one row of ``metrics.jsonl``, and between checkpoints."""


def train(
    algorithm: Algorithm,
    run: Path,
    evaluate: Evaluate,
    evaluate_every: int,
    advance: Advance = silent,
) -> None:
    """Update until the config's number of updates, from wherever the algorithm stands.

    Args:
        algorithm: Fresh, or resumed by ``resume``.
        run: Its folder.
        evaluate: Called before the first, every ``evaluate_every``-th and last update.
        evaluate_every: [updates]
        advance: Told the updates.

    Raises:
        KeyboardInterrupt: After Ctrl-C, saying which checkpoint there is.
    """
    torch.set_num_threads(1)  # small batches: a second thread only costs
    total = algorithm.config.updates
    saved = algorithm.step
    sums: dict[str, float] = {}
    advance(algorithm.step, "")
    try:
        if algorithm.step == 0:
            _log(run, {"step": 0, **evaluate(_policy(algorithm))})
        while algorithm.step < total:
            for key, value in algorithm.update().items():
                sums[key] = sums.get(key, 0.0) + value
            step = algorithm.step
            measure = step % evaluate_every == 0 or step == total
            if not measure and step % LOG_EVERY:
                continue
            means = {key: value / (step - saved) for key, value in sums.items()}
            measured = evaluate(_policy(algorithm)) if measure else {}
            _log(run, {"step": step, **means, **measured})
            save_checkpoint(run / FILE, algorithm)
            losses = [value for key, value in means.items() if key.startswith("loss/")]
            advance(step - saved, f"loss {sum(losses):.4f}")
            saved, sums = step, {}
    except KeyboardInterrupt:
        kept = f"{run} holds the checkpoint of update {saved}: go on with --resume"
        nothing = "before the first checkpoint: start again with --overwrite"
        raise KeyboardInterrupt(f"stopped; {kept if saved else nothing}") from None


def resume(algorithm: Algorithm, run: Path) -> None:
    """Bring a fresh algorithm to a run's checkpoint, and its metrics to that step.

    Raises:
        CheckpointError: If the run is of another algorithm or another config.
    """
    checkpoint = read_checkpoint(run, algorithm.name)
    mine = _comparable(asdict(algorithm.config))  # type: ignore[call-overload]
    refuse_difference(run, _comparable(checkpoint["config"]), mine)
    algorithm.load_state(checkpoint["state"])
    rows = [row for row in read_metrics(run) if row["step"] <= algorithm.step]
    with new_file(run / "metrics.jsonl") as temporary:
        temporary.write_text("".join(json.dumps(row) + "\n" for row in rows))


def refuse_difference(run: Path, theirs: dict[str, Any], mine: dict[str, Any]) -> None:
    """Raise if a run was made with something else than what resumes it.

    Raises:
        CheckpointError: Naming the first key that differs.
    """
    for key, value in mine.items():
        if theirs.get(key) != value:
            raise CheckpointError(
                f"{run} was trained with {key} = {theirs.get(key)}, got {value}: "
                "resume with the same, or start anew with --overwrite"
            )


def read_metrics(run: Path) -> list[dict[str, Any]]:
    """The rows of a run's ``metrics.jsonl``; a last line cut off is left out."""
    path = run / "metrics.jsonl"
    if not path.exists():
        return []
    lines = path.read_text().splitlines(keepends=True)
    return [json.loads(line) for line in lines if line.endswith("\n")]


def _comparable(config: dict[str, Any]) -> dict[str, Any]:
    """As JSON gives it back: tuples are lists."""
    values: dict[str, Any] = json.loads(json.dumps(config))
    return values


def _policy(algorithm: Algorithm) -> LearnedPolicy:
    return LearnedPolicy(algorithm.name, algorithm.agents)


def _log(run: Path, row: dict[str, Any]) -> None:
    with (run / "metrics.jsonl").open("a") as file:
        file.write(json.dumps(row) + "\n")
