"""Files that policies are written as: TorchScript and ONNX, with metadata in them."""

import hashlib
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from marl_mm.archives import check_archive
from marl_mm.registry import Registry

Inputs = tuple[torch.Tensor, ...]
"""Observations, float32, shape (n, d), and the noise of policies that take some."""

Run = Callable[[Inputs], np.ndarray]
"""A written file: from inputs to actions."""


@dataclass(frozen=True, kw_only=True)
class PolicyFormat:
    """A kind of file that a policy can be written as."""

    about: str
    """Runtime, in a sentence."""

    suffix: str
    """Ending of its files."""

    write: Callable[[nn.Module, Inputs, Path, dict[str, Any]], Run]
    """Writes a module, given some inputs, a path and the metadata to go in, and returns
    what the file does."""

    metadata: Callable[[Path], str]
    """Reads the metadata in a file, as JSON, and runs nothing of it."""

    packages: tuple[str, ...] = ()
    """Modules that it needs, of the optional extra of its name."""


POLICY_FORMATS: Registry[PolicyFormat] = Registry("format", of=PolicyFormat)
"""Kinds of files that policies can be written as."""

_METADATA = "marl_mm"
"""Name of the metadata in TorchScript's extra files and ONNX's properties."""


def _torchscript(
    module: nn.Module, example: Inputs, path: Path, metadata: dict[str, Any]
) -> Run:
    unchecked: Any = torch.jit.trace  # ``export_policy`` compares what was written
    traced = unchecked(module, example, check_trace=False)
    file = BytesIO()  # torch would end the process on a full disk
    torch.jit.save(traced, file, {_METADATA: json.dumps(metadata)})
    path.write_bytes(file.getbuffer())
    loaded = torch.jit.load(path)  # type: ignore[no-untyped-call]

    def run(inputs: Inputs) -> np.ndarray:
        actions: np.ndarray = loaded(*inputs).numpy()
        return actions

    return run


def _onnx(
    module: nn.Module, example: Inputs, path: Path, metadata: dict[str, Any]
) -> Run:
    import onnxruntime

    names = ["observation", "noise"][: len(example)]
    program = torch.onnx.export(
        module,
        example,
        dynamo=True,
        input_names=names,
        output_names=["action"],
        dynamic_shapes=({0: torch.export.Dim("n")},) * len(example),
        verbose=False,
    )
    assert program is not None
    proto = program.model_proto
    metadata["content_sha256"] = _onnx_digest(proto)
    entry = proto.metadata_props.add()
    entry.key, entry.value = _METADATA, json.dumps(metadata)
    path.write_bytes(proto.SerializeToString())
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])

    def run(inputs: Inputs) -> np.ndarray:
        arrays = (values.numpy() for values in inputs)
        (actions,) = session.run(None, dict(zip(names, arrays, strict=True)))
        return np.asarray(actions)

    return run


def _torchscript_metadata(path: Path) -> str:
    check_archive(path)
    with zipfile.ZipFile(path) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith(f"/extra/{_METADATA}"))
        return archive.read(name).decode()


def _onnx_metadata(path: Path) -> str:
    import onnx

    model = onnx.load_model(path, load_external_data=False)
    stored = [*model.graph.initializer]
    if any(tensor.data_location == onnx.TensorProto.EXTERNAL for tensor in stored):
        raise ValueError("weights in other files")
    onnx.checker.check_model(model)
    (text,) = (p.value for p in model.metadata_props if p.key == _METADATA)
    written = json.loads(text).get("content_sha256")  # version 1 has none
    if written not in (None, _onnx_digest(model)):
        raise ValueError("its content is not what was written")
    return str(text)


def _onnx_digest(model: Any) -> str:
    """SHA-256 of a model's operations and weights, in hex digits."""
    digest = hashlib.sha256()
    graph = model.graph
    for part in (*graph.node, *graph.initializer, *graph.input, *graph.output):
        digest.update(part.SerializeToString(deterministic=True))
    return digest.hexdigest()


POLICY_FORMATS.add(
    "torchscript",
    PolicyFormat(
        about="TorchScript, run by torch.jit.load.",
        suffix=".ts",
        write=_torchscript,
        metadata=_torchscript_metadata,
    ),
)
POLICY_FORMATS.add(
    "onnx",
    PolicyFormat(
        about="ONNX, run by onnxruntime.",
        suffix=".onnx",
        write=_onnx,
        metadata=_onnx_metadata,
        packages=("onnx", "onnxscript", "onnxruntime"),
    ),
)
