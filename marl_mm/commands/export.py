"""marl-mm export: a policy as a file that runs without this package."""

from pathlib import Path
from typing import Annotated

import tyro

from marl_mm.algorithms.export import signature
from marl_mm.algorithms.export_formats import POLICY_FORMATS
from marl_mm.commands.output import show
from marl_mm.commands.parser import command
from marl_mm.runs.export import export

_FORMATS = f'{" or ".join(POLICY_FORMATS.names())}; onnx needs the extra "onnx".'


@command
def main(
    run: tyro.conf.Positional[str],
    *,
    format: Annotated[str, tyro.conf.arg(help=_FORMATS)] = "torchscript",
    agent: str | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Write a policy as TorchScript or ONNX, to run beside a real controller.

    The file takes observations, float32, shape (n, d), and returns actions, shape
    (n, k), in the action space: displacements of the end-effector's target [0.1 m] and
    alpha. That of a policy that draws its actions takes standard normal noise, too;
    Q-chunking's returns plans, shape (n, steps, k). Names of entries and the actions'
    bounds lie in it. Its actions are compared with the policy's before it appears.

    Args:
        run: Run folder, checkpoint file or "pretrained".
        format: Format of the file.
        agent: One decentralised actor on its own observation; default the joint action
            at the joint state.
        out: File; default RUN/policy or RUN/AGENT with .ts or .onnx, of RUN/best.pt
            RUN/best-policy or RUN/best-AGENT, for "pretrained" in this folder.
        overwrite: Replace OUT if it exists.
        json: Print the file's metadata and the largest difference as JSON.
    """
    about = export(run, out, format=format, agent=agent, overwrite=overwrite)
    difference = f"{about['largest_difference']:.1g}"
    close = f"as the policy to {difference} of an action's half range"
    text = f"{about['file']}: {signature(about)}; acts {close}"
    show(about, text, json)
