"""The training loop and the run folder it fills.

A run is a folder: ``config.json`` (written before the first step), ``metrics.jsonl``,
TensorBoard's ``events*``, ``checkpoint.pt`` and, from the last evaluation,
``eval.json``.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import torch

from marl_mm.algorithms.algorithm import Algorithm, Resumable
from marl_mm.algorithms.checkpoint import FILE, read_checkpoint, save_checkpoint
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.runlog import RunLog
from marl_mm.differences import refuse_difference
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
    with RunLog(run, "step", since=algorithm.step) as log:
        saved = algorithm.step
        sums: dict[str, float] = {}
        advance(algorithm.step, "")
        try:
            if algorithm.step == 0:
                log.add({"step": 0, **evaluate(_policy(algorithm))})
            while algorithm.step < total:
                for key, value in algorithm.update().items():
                    sums[key] = sums.get(key, 0.0) + value
                step = algorithm.step
                measure = step % evaluate_every == 0 or step == total
                if not measure and step % LOG_EVERY:
                    continue
                means = {key: value / (step - saved) for key, value in sums.items()}
                measured = evaluate(_policy(algorithm)) if measure else {}
                log.add({"step": step, **means, **measured})
                save_checkpoint(run / FILE, algorithm)
                losses = [v for key, v in means.items() if key.startswith("loss/")]
                advance(step - saved, f"loss {sum(losses):.4f}")
                saved, sums = step, {}
        except KeyboardInterrupt:
            kept = f"{run} holds the checkpoint of update {saved}: go on with --resume"
            nothing = "before the first checkpoint: start again with --resume"
            raise KeyboardInterrupt(f"stopped; {kept if saved else nothing}") from None


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
    checkpoint = read_checkpoint(run, algorithm.name)
    mine = asdict(algorithm.config)
    for name in ignored:
        del mine[name]
    refuse_difference(run, checkpoint["config"], mine)
    algorithm.load_state(checkpoint["state"])


def _policy(algorithm: Algorithm) -> LearnedPolicy:
    return LearnedPolicy(algorithm.name, algorithm.agents)
