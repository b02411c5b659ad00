"""marl-mm export: a policy as a file that runs without this package."""

from pathlib import Path
from typing import Annotated

import tyro

from marl_mm.algorithms.checkpoint import BEST
from marl_mm.algorithms.export import export_policy, signature
from marl_mm.algorithms.export_formats import POLICY_FORMATS
from marl_mm.algorithms.policy import load_policy
from marl_mm.commands.output import show
from marl_mm.commands.parser import command
from marl_mm.errors import UsageError
from marl_mm.files import refuse_existing

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
    alpha. That of a flow or its student takes standard normal noise, too; Q-chunking's
    returns plans, shape (n, steps, k). Names of entries and the actions' bounds lie in
    it. Its actions are compared with the policy's before it appears.

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
    policy, path = load_policy(run), Path(run)
    best = "best-" if path.is_file() and path.name == BEST else ""
    name = f"{best}{agent or 'policy'}{POLICY_FORMATS.get(format).suffix}"
    out = out or (path if path.is_dir() else path.parent) / name
    if out.is_dir():
        raise UsageError(f"--out {out} is a folder, expected a file: {out}/{name}")
    refuse_existing(out, overwrite)
    about = export_policy(policy, out, format, agent)
    difference = f"{about['largest_difference']:.1g}"
    text = f"{out}: {signature(about)}; at most {difference} of half a range off"
    show({"file": str(out), **about}, text, json)
