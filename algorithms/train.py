"""The training loop and the run folder it fills.

A run is a folder: ``config.json`` (written before the first step), ``metrics.jsonl``,
``checkpoint.pt`` and, from the last evaluation, ``eval.json``.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from marl_mm.algorithms.checkpoint import FILE, read_checkpoint, save_checkpoint
from marl_mm.algorithms.mabc import Mabc
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.errors import CheckpointError
from marl_mm.files import new_file
from marl_mm.progress import Advance, silent

Evaluate = Callable[[LearnedPolicy], dict[str, float]]
"""Measures a policy; the loop knows nothing of environments."""

LOG_EVERY = 100
"""Updates whose mean is one row of ``metrics.jsonl``."""


def train(
    algorithm: Mabc,
    run: Path,
    evaluate: Evaluate,
    evaluate_every: int,
    advance: Advance = silent,
) -> None:
    """Update until the config's number of updates, from wherever the algorithm stands.

    Args:
        algorithm: Fresh, or resumed by ``resume``.
        run: Its folder.
        evaluate: Called every ``evaluate_every`` updates, and after the last.
        evaluate_every: [updates]
        advance: Told the updates.

    Raises:
        KeyboardInterrupt: After Ctrl-C, once the checkpoint is written.
    """
    torch.set_num_threads(1)  # small batches: a second thread only costs
    total = algorithm.config.updates
    sums: dict[str, float] = {}
    advance(algorithm.step, "")
    try:
        if algorithm.step == 0:
            _log(run, {"step": 0, **evaluate(_policy(algorithm))})
        while algorithm.step < total:
            for key, value in algorithm.update().items():
                sums[key] = sums.get(key, 0.0) + value
            step = algorithm.step
            if step % LOG_EVERY == 0 or step == total:
                count = (step - 1) % LOG_EVERY + 1
                row = {"step": step, **{k: v / count for k, v in sums.items()}}
                sums = {}
                if step % evaluate_every == 0 or step == total:
                    row |= evaluate(_policy(algorithm))
                _log(run, row)
                save_checkpoint(run / FILE, algorithm)
                losses = [v for k, v in row.items() if k.startswith("loss/")]
                advance(count, f"loss {sum(losses):.4f}")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; {run} holds the checkpoint of the last {LOG_EVERY} updates: "
            "go on with --resume"
        ) from None


def resume(algorithm: Mabc, run: Path) -> None:
    """Bring a fresh algorithm to a run's checkpoint, and its metrics to that step.

    Raises:
        CheckpointError: If the run is of another algorithm or another config.
    """
    checkpoint = read_checkpoint(run, algorithm.name)
    mine, theirs = json.loads(json.dumps(_config(algorithm))), checkpoint["config"]
    theirs = json.loads(json.dumps(theirs))
    different = [key for key in mine if mine[key] != theirs.get(key)]
    if different:
        key = different[0]
        raise CheckpointError(
            f"{run} was trained with {key} = {theirs.get(key)}, got {mine[key]}: "
            "resume with the same config"
        )
    algorithm.load_state(checkpoint["state"])
    rows = [row for row in read_metrics(run) if row["step"] <= algorithm.step]
    with new_file(run / "metrics.jsonl") as temporary:
        temporary.write_text("".join(json.dumps(row) + "\n" for row in rows))


def read_metrics(run: Path) -> list[dict[str, Any]]:
    """The rows of a run's ``metrics.jsonl``; a last line cut off is left out."""
    path = run / "metrics.jsonl"
    if not path.exists():
        return []
    lines = path.read_text().splitlines(keepends=True)
    return [json.loads(line) for line in lines if line.endswith("\n")]


def _config(algorithm: Mabc) -> dict[str, Any]:
    return {k: getattr(algorithm.config, k) for k in vars(algorithm.config)}


def _policy(algorithm: Mabc) -> LearnedPolicy:
    return LearnedPolicy(algorithm.name, algorithm.agents)


def _log(run: Path, row: dict[str, Any]) -> None:
    with (run / "metrics.jsonl").open("a") as file:
        file.write(json.dumps(row) + "\n")
