"""marl-mm export: a policy as a file that runs without this package."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from marl_mm.algorithms.checkpoint import BEST
from marl_mm.algorithms.export import POLICY_FORMATS, export_policy
from marl_mm.algorithms.policy import load_policy
from marl_mm.commands.parser import parse_options
from marl_mm.errors import UsageError
from marl_mm.files import refuse_existing


@dataclass(frozen=True)
class Export:
    """Write a policy as TorchScript or ONNX, to run beside a real controller.

    The file takes observations, float32, shape (n, d), and returns actions, shape
    (n, k), in the action space: displacements of the end-effector's target [m] and
    alpha. Names of all entries and the actions' bounds lie in the file. Its actions are
    compared with the policy's before it appears.
    """

    run: tyro.conf.Positional[str]
    """Run folder, checkpoint file or "pretrained"."""

    format: Annotated[
        str,
        tyro.conf.arg(
            help=f'{" or ".join(POLICY_FORMATS.names())}; onnx needs the extra "onnx".'
        ),
    ] = "torchscript"

    agent: str | None = None
    """One decentralised actor on its own observation; default the joint action at the
    joint state."""

    out: Path | None = None
    """File; default RUN/policy or RUN/AGENT with .ts or .onnx, of RUN/best.pt
    RUN/best-policy or RUN/best-AGENT, for "pretrained" in this folder."""

    overwrite: bool = False
    """Replace OUT if it exists."""

    json: bool = False
    """Print the file's metadata and the largest difference as JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm export``."""
    options = parse_options(Export, "marl-mm export", arguments)
    policy = load_policy(options.run)
    run = Path(options.run)
    folder = run if run.is_dir() else run.parent
    best = "best-" if run.is_file() and run.name == BEST else ""
    name = (
        f"{best}{options.agent or 'policy'}{POLICY_FORMATS.get(options.format).suffix}"
    )
    out = options.out or folder / name
    if out.is_dir():
        raise UsageError(
            f"--out {out} is a folder, expected a file such as {out}/{name}"
        )
    refuse_existing(out, options.overwrite)
    about = export_policy(policy, out, options.format, options.agent)
    if options.json:
        print(json.dumps({"file": str(out), **about}, indent=2))
        return
    print(
        f"{out}: {', '.join(about['observation'])} -> {', '.join(about['action'])}; "
        f"actions differ from the run's by at most {about['largest_difference']:.1g}"
    )
