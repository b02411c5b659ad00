"""The agent that ships with the package: DDPG with hindsight on ``Reach-v0``.

Its folder holds ``policy.safetensors`` (the actor), ``config.json`` (hyper-parameters,
seed and versions of the run), ``metrics.jsonl`` (its learning curve) and ``eval.json``.
"""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save

from marl_mm.algorithms.actors import actors_from
from marl_mm.algorithms.checkpoint import BEST, DAMAGE, read_checkpoint
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.runlog import METRICS
from marl_mm.envs.registry import make_task
from marl_mm.errors import CheckpointError
from marl_mm.files import new_folder, write_json
from marl_mm.layout import Layout
from marl_mm.received import check_regular, file_digest, read_json

NAME = "pretrained"
FOLDER = Path(__file__).parent / "pretrained_agent"
"""Folder of the shipped agent."""

WEIGHTS = "policy.safetensors"

_SHIPPED = "ddec5644189035eb447e6ee475ae547924bc5d2142c3a82bc882f28d7e07d560"
"""SHA-256 of the shipped agent's weights; its config, which is older, has none."""

_CONFIG_BYTES = 1_000_000
"""Largest size of the config [bytes]; the shipped agent's has 2,000."""

_WEIGHTS_BYTES = 100_000_000
"""Largest size of the weights [bytes]; those of two actors of 256 x 256 units have
600,000."""

_HEADER_BYTES = 100_000
"""Largest size of the weights' names and shapes [bytes]; the shipped agent's are in
a thousand."""


def ship(run: Path, folder: Path) -> None:
    """Make a shippable folder of an online run's best policy.

    Args:
        run: A finished run.
        folder: Folder to write; replaced if it exists.
    """
    config = json.loads((run / "config.json").read_text("utf-8"))
    if config.get("dataset"):
        del config["dataset"]["path"]  # of the machine it was trained on
    with new_folder(folder) as new:
        write_actors(new, read_checkpoint(run / BEST), config)
        shutil.copy(run / METRICS, new / METRICS)
        evaluation = json.loads((run / "eval_best.json").read_text("utf-8"))
        evaluation["policy_config"] = {}
        (new / "eval.json").write_text(json.dumps(evaluation, indent=1) + "\n", "utf-8")


def write_actors(
    folder: Path, checkpoint: Mapping[str, Any], config: Mapping[str, Any]
) -> None:
    """Write a checkpoint's actors and a run's record, which ``load_pretrained`` reads.

    Args:
        folder: Folder that exists.
        checkpoint: Checkpoint of ``read_checkpoint``.
        config: Record of the run, JSON-serialisable; layout and hash are added.
    """
    tensors = {
        f"{agent}/{key}": value.contiguous()
        for agent, state in checkpoint["state"]["actors"].items()
        for key, value in state.items()
    }
    (folder / WEIGHTS).write_bytes(save(tensors))
    made = {
        **config,
        "layout": checkpoint["layout"].to_json(),
        "weights_sha256": file_digest(folder / WEIGHTS, CheckpointError),
    }
    write_json(folder / "config.json", made)


def load_pretrained(folder: Path = FOLDER) -> LearnedPolicy:
    """The shipped agent, or one whose weights were written as its are.

    Raises:
        CheckpointError: If its files are missing or damaged.
    """
    shipped = folder.resolve() == FOLDER.resolve()
    try:
        config = read_json(folder / "config.json", CheckpointError, _CONFIG_BYTES)
        expected = config.get("weights_sha256", _SHIPPED if shipped else None)
        check_regular(folder / WEIGHTS, CheckpointError, _WEIGHTS_BYTES)
        digest = file_digest(folder / WEIGHTS, CheckpointError)
        _check_header(folder / WEIGHTS)
        if expected not in (None, digest):
            raise ValueError(f"the bytes of {WEIGHTS} are not those that were written")
        tensors = load_file(folder / WEIGHTS)
        states: dict[str, dict[str, Any]] = {}
        for name, value in tensors.items():
            agent, _, key = name.partition("/")
            states.setdefault(agent, {})[key] = value
        recorded = config.get("layout")  # the shipped agent has none: it is older
        layout = (
            Layout.from_json(recorded) if recorded else make_task(config["task"]).layout
        )
        agents = actors_from(states, layout)
        if others := sorted(states.keys() - agents.keys()):
            raise ValueError(f"weights of {', '.join(others)}, which no agent is")
    except (*DAMAGE, OSError, SafetensorError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise CheckpointError(f"{folder} is damaged ({reason:.80})") from error
    if shipped:
        return LearnedPolicy(NAME, agents, layout, NAME)
    name = str(config.get("algorithm", folder.name))
    return LearnedPolicy(name, agents, layout, str(folder))


def _check_header(path: Path) -> None:
    """Raise for weights whose names and shapes are too many.

    A file of safetensors begins with their size in eight bytes.
    """
    with path.open("rb") as file:
        size = int.from_bytes(file.read(8), "little")
    if size > _HEADER_BYTES:
        raise ValueError(
            f"{WEIGHTS} has a header of {size:,} bytes, over {_HEADER_BYTES:,}"
        )
