"""Checkpoints: one file that acts and resumes without anything else."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from marl_mm.algorithms.mabc import Mabc, MabcConfig
from marl_mm.errors import CheckpointError, UsageError
from marl_mm.files import new_file
from marl_mm.layout import AGENTS

FILE = "checkpoint.pt"
_FORMAT = "marl_mm checkpoint 1"


def save_checkpoint(path: Path, algorithm: Mabc) -> None:
    """Write an algorithm's state with its config and agent order, atomically."""
    with new_file(path) as temporary:
        torch.save(
            {
                "format": _FORMAT,
                "algorithm": algorithm.name,
                "config": asdict(algorithm.config),
                "agents": [agent.name for agent in AGENTS],
                "state": algorithm.state(),
            },
            temporary,
        )


def read_checkpoint(path: Path, algorithm: str | None = None) -> dict[str, Any]:
    """Read a checkpoint file, or the one in a run folder.

    Args:
        path: File or run folder.
        algorithm: The algorithm it must be of; None accepts any.

    Raises:
        UsageError: If there is no such file.
        CheckpointError: If it is damaged or of another algorithm.
    """
    file = path / FILE if path.is_dir() else path
    if not file.exists():
        raise UsageError(
            f"no checkpoint at {file}, expected a run folder made by marl-mm train"
        )
    try:
        checkpoint = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises whatever its unpickler met
        reason = str(error).splitlines()[0]
        raise CheckpointError(f"{file} is damaged ({reason:.80})") from error
    if not isinstance(checkpoint, dict) or checkpoint.get("format") != _FORMAT:
        raise CheckpointError(f"{file} is not a {_FORMAT!r} file")
    expected = algorithm or Mabc.name
    if checkpoint["algorithm"] != expected:
        raise CheckpointError(
            f"{file} holds a checkpoint of algorithm {checkpoint['algorithm']!r}, "
            f"expected {expected!r}"
        )
    return checkpoint


def checkpoint_config(checkpoint: dict[str, Any]) -> MabcConfig:
    """The hyper-parameters a checkpoint was trained with."""
    values = checkpoint["config"]
    return MabcConfig(**{**values, "hidden": tuple(values["hidden"])})
