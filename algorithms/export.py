"""Policies as files that run without this package: TorchScript and ONNX.

A file takes observations, float32, shape (n, d), and returns actions in the action
space, shape (n, k); within it lie the names of their entries and the actions' bounds.
That of a policy that draws its actions takes standard normal noise, too, shape (n, m),
and one that plans h actions in a row returns shape (n, h, k).
"""

import hashlib
import json
import logging
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.archives import check_archive
from marl_mm.errors import ExportError, LayoutError, UsageError
from marl_mm.files import new_file
from marl_mm.layout import Layout, in_order
from marl_mm.received import check_regular, parse_json
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

TOLERANCE = 1e-5
"""Largest difference between a file's actions and the policy's."""

_CHECKS = 1_000
"""Observations at which they are compared."""

_METADATA = "marl_mm"
"""Name of the metadata in TorchScript's extra files and ONNX's properties."""


def export_policy(
    policy: LearnedPolicy, path: Path, form: str, agent: str | None = None
) -> dict[str, Any]:
    """Write a policy, and compare what the file does with what the policy does.

    Args:
        policy: Trained.
        path: The file; it appears when the comparison has passed.
        form: Name of one of ``POLICY_FORMATS``.
        agent: One decentralised actor on its own observation; None for the joint
            action at the joint state.

    Returns:
        The file's metadata, and the largest difference found.

    Raises:
        UsageError: If there is no such agent, or a library is missing.
        ExportError: If the file's actions differ by more than ``TOLERANCE``.
        OSError: If there is no room for the file; it names the file.
    """
    chosen = POLICY_FORMATS.get(form)
    _refuse_missing(form, chosen)
    module = _Exported(policy, agent).eval()
    metadata = module.metadata | {"policy": policy.name, "weights": policy.fingerprint}
    inputs = module.some(_CHECKS)
    with new_file(path) as temporary:
        with _quiet():
            few = tuple(values[:2] for values in inputs)
            run = chosen.write(module, few, temporary, metadata)
        difference = np.abs(run(inputs) - module.expected(*inputs))
        if not difference.max() <= TOLERANCE:
            raise ExportError(
                f"the exported policy's actions differ from the run's by "
                f"{difference.max():.2g}, expected at most {TOLERANCE:g}: no file was "
                "written"
            )
    return metadata | {"largest_difference": float(difference.max())}


def exported_metadata(path: Path) -> dict[str, Any]:
    """The metadata of an exported policy: layout, entries, bounds. Nothing is run.

    Raises:
        UsageError: If its name ends in none of the formats' suffixes, or a library is
            missing.
        ExportError: If the file is damaged, or none of ours.
    """
    forms = [(name, f) for name, f in POLICY_FORMATS.items() if f.suffix == path.suffix]
    if not forms:
        suffixes = ", ".join(form.suffix for _, form in POLICY_FORMATS.items())
        raise UsageError(f"{path} ends in {path.suffix!r}, expected {suffixes}")
    ((name, form),) = forms
    _refuse_missing(name, form)
    check_regular(path, ExportError)
    try:
        text = form.metadata(path)
    except Exception as error:  # whatever the library meets
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ExportError(f"{path} is damaged ({reason:.80})") from error
    values = parse_json(text, str(path), ExportError)
    try:
        layout = Layout.from_json(values["layout"])
        entries = {"observation": layout.state_names, "action": layout.action_names}
        if not all({*values[key]} <= {*names} for key, names in entries.items()):
            raise LayoutError("entries that its layout has not")
    except (KeyError, TypeError, LayoutError) as error:
        raise ExportError(f"{path} is no exported policy ({error!s:.120})") from error
    metadata: dict[str, Any] = values
    return metadata


def _refuse_missing(name: str, form: PolicyFormat) -> None:
    if any(find_spec(package) is None for package in form.packages):
        needed = ", ".join(form.packages)
        raise UsageError(f"{needed} missing: pip install 'marl-mm[{name}]'")


class _Exported(nn.Module):
    """Some of a policy's actors, from what is observed to what is set."""

    def __init__(self, policy: LearnedPolicy, agent: str | None) -> None:
        super().__init__()
        agents = policy.agents
        if agent is not None and agent not in agents:
            raise UsageError(
                f"{policy.name} has no agent {agent!r}, expected {' or '.join(agents)}"
            )
        chosen = [agents[agent]] if agent else list(agents.values())
        # Copies, whose weights no longer learn: so that actions are plain numbers.
        self._agents = [AgentActor(a.layout, deepcopy(a.actor)) for a in chosen]
        self._alone = agent is not None
        self._actors = nn.ModuleList(agent.actor for agent in self._agents)
        self.requires_grad_(False)
        layout = self._layout = policy.layout
        layouts = [agent.layout for agent in self._agents]
        entries = [i for layout in layouts for i in layout.action]
        self._order = None if self._alone else in_order(layouts)
        if self._order is not None:
            entries = [entries[i] for i in self._order]
        observation = self._agents[0].layout.observation
        seen = observation if self._alone else range(len(layout.state))
        self.metadata: dict[str, Any] = {
            "layout": layout.to_json(),
            "observation": [layout.state_names[i] for i in seen],
            "action": [layout.action_names[i] for i in entries],
            "action_low": [layout.low[i] for i in entries],
            "action_high": [layout.high[i] for i in entries],
        }
        self._noise = [agent.actor.noise for agent in self._agents]
        self._chunk = max(agent.actor.form.chunk for agent in self._agents)
        if any(self._noise):
            self.metadata["noise"] = sum(self._noise)
        if self._chunk > 1:
            self.metadata["chunk"] = self._chunk

    def forward(
        self, observation: torch.Tensor, noise: torch.Tensor | None = None
    ) -> torch.Tensor:
        parts = []
        own = self._own(noise)
        for agent in self._agents:
            observed = self._observed(agent, observation)
            parts.append(agent.planned(agent.actor(observed, next(own, None))))
        joined = torch.cat(parts, dim=-1)
        joined = joined if self._order is None else joined[..., self._order]
        return joined if self._chunk > 1 else joined.squeeze(-2)

    def _own(self, noise: torch.Tensor | None = None) -> Iterator[torch.Tensor]:
        """Each agent's part of the noise."""
        return iter(() if noise is None else torch.split(noise, self._noise, -1))

    def _observed(self, agent: AgentActor, observation: torch.Tensor) -> torch.Tensor:
        return observation if self._alone else agent.observed(observation)

    def some(self, count: int) -> Inputs:
        """Observations around those that the actors were trained on, and noise."""
        rng = np.random.default_rng(0)
        width = len(self._layout.state)
        mean, std = torch.zeros(width), torch.ones(width)
        for agent in self._agents:
            entries = list(agent.layout.observation)
            mean[entries] = agent.actor.normalizer.mean
            std[entries] = agent.actor.normalizer.std
        draws = torch.from_numpy(rng.standard_normal((count, width), np.float32))
        states = mean + 2 * std * draws
        observations = self._agents[0].observed(states) if self._alone else states
        if not any(self._noise):
            return (observations,)
        noise = rng.standard_normal((count, sum(self._noise)), np.float32)
        return observations, torch.from_numpy(noise)

    def expected(self, *inputs: torch.Tensor) -> np.ndarray:
        """Actions, one observation at a time, as in an episode."""
        rows = []
        for observation, *noise in zip(*inputs, strict=True):
            own = self._own(*noise)
            plans = [
                agent.plan(self._observed(agent, observation).numpy(), next(own, None))
                for agent in self._agents
            ]
            joined = np.concatenate(plans, axis=-1)
            joined = joined if self._order is None else joined[:, self._order]
            rows.append(joined if self._chunk > 1 else joined[0])
        return np.array(rows)


def _torchscript(
    module: nn.Module, example: Inputs, path: Path, metadata: dict[str, Any]
) -> Run:
    traced = torch.jit.trace(module, example)  # type: ignore[no-untyped-call]
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


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the exporters' warnings about themselves and missing packages."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
