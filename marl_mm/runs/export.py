"""Policies as files that run without this package."""

from pathlib import Path
from typing import Any

from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.export import export_policy
from marl_mm.algorithms.export_formats import POLICY_FORMATS
from marl_mm.algorithms.policy import load_policy
from marl_mm.errors import UsageError
from marl_mm.files import refuse_existing
from marl_mm.runs.folder import export_name
from marl_mm.runs.run import Run
from marl_mm.runs.settings import as_path
from marl_mm.runs.submission import EPISODES


def export(
    run: Run | str | Path,
    out: str | Path | None = None,
    *,
    format: str = "torchscript",
    agent: str | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write a learnt policy as TorchScript or ONNX, to run beside a real controller.

    The file takes observations, float32, shape (n, d), and returns actions, shape
    (n, k), in the action space. Its actions are compared with the policy's before it
    appears.

    Args:
        run: Run, its folder, checkpoint file, or ``pretrained``.
        out: File; default RUN/policy or RUN/AGENT with .ts or .onnx, of RUN/best.pt
            RUN/best-policy or RUN/best-AGENT, for ``pretrained`` and what was submitted
            in this folder.
        format: ``torchscript``, ``onnx``, or a plug-in's.
        agent: One decentralised actor on its own observation; default the joint action
            at the joint state.
        overwrite: Whether the file may be replaced.

    Returns:
        The file's metadata: ``file``, names of entries, the actions' bounds, and
        ``largest_difference``, in halves of their range.

    Raises:
        UsageError: If there is no such agent, or a library is missing.
        OutputExistsError: If there is the file, and it may not be replaced.
        ExportError: If the file's actions differ from the policy's.
    """
    source = str(run.folder if isinstance(run, Run) else run)
    policy, path = load_policy(source), Path(source)
    suffix = POLICY_FORMATS.get(format).suffix
    name = export_name(path.name if path.is_file() else FILE, agent, suffix)
    submitted = (path / EPISODES).exists()  # nothing is added to that
    default = Path() if submitted else path if path.is_dir() else path.parent
    default /= name
    file = default if out is None else as_path(out, "out", "a file")
    if file.is_dir():
        raise UsageError(f"`out` {file} is a folder, expected a file: {file}/{name}")
    if file.suffix != suffix:
        raise UsageError(f"`out` is {file}, expected a file that ends in {suffix}")
    refuse_existing(file, overwrite)
    return {"file": str(file), **export_policy(policy, file, format, agent)}
