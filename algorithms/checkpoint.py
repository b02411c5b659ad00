"""Checkpoints: one file that acts and resumes without anything else."""

from collections.abc import Mapping
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from marl_mm.algorithms.actors import AgentActor, actors_from
from marl_mm.algorithms.algorithm import OfflineAlgorithm, Resumable
from marl_mm.archives import check_saved
from marl_mm.errors import CheckpointError, LayoutError, UsageError
from marl_mm.files import write_bytes
from marl_mm.layout import Layout
from marl_mm.received import (
    check_kind,
    check_plain,
    check_regular,
    refuse_links_out,
)
from marl_mm.registry import NAME
from marl_mm.version1 import checkpoint_layout

FILE = "checkpoint.pt"
"""Name of a run's last checkpoint."""

BEST = "best.pt"
"""Name of a run's best policy, by its learning curve."""

_FORMAT = "marl_mm checkpoint 2"

_FORMATS = ("marl_mm checkpoint 1", _FORMAT)
"""Formats that can be read; the first one's layouts are those of version 1."""


def checkpoint(algorithm: Resumable) -> memoryview:
    """An algorithm's state with its config and layout, as bytes."""
    return _bytes(algorithm, algorithm.state())


def policy_checkpoint(algorithm: Resumable) -> memoryview:
    """A checkpoint of the actors alone, which can act but not resume."""
    actors = {name: a.actor.state_dict() for name, a in algorithm.agents.items()}
    return _bytes(algorithm, {"actors": actors})


def save_seed(path: Path, algorithm: OfflineAlgorithm, number: int) -> None:
    """Write one seed's state of an offline algorithm; see ``write_bytes``."""
    write_bytes(path, _bytes(algorithm, algorithm.state(number)))


def save_seeds_policy(path: Path, algorithm: OfflineAlgorithm, number: int) -> None:
    """Write a checkpoint of one seed's actors alone; see ``write_bytes``."""
    agents = algorithm.agents(number).items()
    actors = {name: agent.actor.state_dict() for name, agent in agents}
    write_bytes(path, _bytes(algorithm, {"actors": actors}))


def _bytes(
    algorithm: Resumable | OfflineAlgorithm, state: dict[str, Any]
) -> memoryview:
    contents = {
        "format": _FORMAT,
        "algorithm": algorithm.name,
        "config": asdict(algorithm.config),
        "layout": algorithm.layout.to_json(),
        "state": state,
    }
    # Into memory first: torch does not tell of a full disk as Python does.
    file = BytesIO()
    torch.save(contents, file)
    return file.getbuffer()


_KINDS: dict[str, Any] = {
    "algorithm": str,
    "config": dict[str, Any],
    "layout": dict[str, Any],
    "state": dict[str, Any],
}
"""Types of a checkpoint's parts."""

DAMAGE = (
    *(KeyError, TypeError, AttributeError, RuntimeError, ValueError, IndexError),
    *(MemoryError, OverflowError),
)
"""Exceptions at states that do not fit what they are loaded into."""


def read_checkpoint(path: Path, algorithm: str | None = None) -> dict[str, Any]:
    """Read a checkpoint file, or the one in a run folder.

    Args:
        path: File or run folder.
        algorithm: The algorithm it must be of; None accepts any.

    Raises:
        UsageError: If there is no such file.
        CheckpointError: If it is damaged, a link out of the run folder, or of another
            algorithm or agent layout.
    """
    file = path / FILE if path.is_dir() else path
    if path.is_dir():
        refuse_links_out(path, [FILE], CheckpointError)
    if not file.exists():
        runs = sorted(other.parent for other in path.glob(f"*/{FILE}"))
        meant = f"; did you mean {runs[0]}?" if runs else ""
        raise UsageError(
            f"no checkpoint at {file}, expected a run folder made by marl-mm train"
            + meant
        )
    check_regular(file, CheckpointError)
    try:
        check_saved(file)
        checkpoint = torch.load(file, map_location="cpu", weights_only=True)
        _check_values(checkpoint)
    except Exception as error:  # torch raises whatever its unpickler met
        if file.suffix != Path(FILE).suffix:
            raise UsageError(
                f"{file} is no checkpoint, expected a run folder, or {FILE} in one"
            ) from None
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        if isinstance(error, UnpicklingError):
            reason = "it holds other Python objects than numbers, texts and tensors"
        raise CheckpointError(
            f"{file} is damaged ({reason:.80}){_way_out(file)}"
        ) from error
    if not isinstance(checkpoint, dict) or checkpoint.get("format") not in _FORMATS:
        raise CheckpointError(f"{file} is not a {_FORMAT!r} file")
    missing = {"algorithm", "config", "layout", "state"} - checkpoint.keys()
    if missing:
        raise CheckpointError(f"{file} lacks {', '.join(sorted(missing))}")
    for name, kind in _KINDS.items():
        check_kind(checkpoint[name], kind, f"{file}: {name}", CheckpointError)
    if not NAME.fullmatch(checkpoint["algorithm"]):
        raise CheckpointError(
            f"{file}: algorithm is {checkpoint['algorithm']!a:.60}, expected a name "
            "such as 'td3-bc'"
        )
    if algorithm is not None and checkpoint["algorithm"] != algorithm:
        raise CheckpointError(
            f"{file} holds a checkpoint of algorithm {checkpoint['algorithm']!r}, "
            f"expected {algorithm!r}"
        )
    try:
        first = checkpoint["format"] == _FORMATS[0]
        layout = (checkpoint_layout if first else Layout.from_json)(
            checkpoint["layout"]
        )
    except LayoutError as error:
        raise CheckpointError(f"{file}: {error}") from error
    return checkpoint | {"layout": layout}


def restored_agents(checkpoint: dict[str, Any], path: Path) -> dict[str, AgentActor]:
    """The actors of a checkpoint.

    Raises:
        CheckpointError: If its networks do not fit its layout.
    """
    try:
        return actors_from(checkpoint["state"]["actors"], checkpoint["layout"])
    except DAMAGE as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise CheckpointError(f"{path} is damaged ({reason:.80})") from error


def check_types(state: Any, fresh: Any, where: str = "state") -> None:
    """Raise for tensors of another type than a fresh learner's: they would be cast.

    Args:
        state: State of a checkpoint.
        fresh: State of a learner with the same config; what it lacks may be anything.
        where: Name of the state, for the message.

    Raises:
        ValueError: Naming the tensor.
    """
    if isinstance(state, torch.Tensor) and isinstance(fresh, torch.Tensor):
        if state.dtype != fresh.dtype:
            raise ValueError(f"{where} has {state.dtype}, expected {fresh.dtype}")
    elif isinstance(state, Mapping) and isinstance(fresh, Mapping):
        for key in state.keys() & fresh.keys():
            check_types(state[key], fresh[key], str(key))
    elif isinstance(state, list | tuple) and isinstance(fresh, list | tuple):
        for old, new in zip(state, fresh, strict=False):
            check_types(old, new, where)


def _check_values(value: Any) -> None:
    """Raise for values whose text cannot be shown, and tensors beyond their data."""
    tensors: list[torch.Tensor] = []
    check_plain(value, "it", CheckpointError, tensors.append)
    for tensor in tensors:
        if not isinstance(tensor, torch.Tensor):
            continue
        if tensor.layout != torch.strided or tensor.is_meta or tensor.is_quantized:
            raise ValueError(f"a tensor of kind {tensor.layout}")
        if tensor.is_complex():
            raise ValueError(f"a tensor of type {tensor.dtype}")
        if tensor.numel() == 0 and max(tensor.shape) > 0:
            raise ValueError(f"an empty tensor of shape {tuple(tensor.shape)}")
        if tensor.numel() * tensor.element_size() > tensor.untyped_storage().nbytes():
            raise ValueError(f"a tensor of shape {tuple(tensor.shape)} with less data")


def _way_out(file: Path) -> str:
    """Hint at the run's best policy, for the message on a damaged checkpoint."""
    best = file.with_name(BEST)
    if file != best and best.exists():
        return f"; the run's best policy, {best}, may be whole"
    return ""
