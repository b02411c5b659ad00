"""Policies as files that run without this package: TorchScript and ONNX.

A file takes observations, float32, shape (n, d), and returns actions in the action
space, shape (n, k); within it lie the names of their entries and the actions' bounds.
That of a policy that draws its actions takes standard normal noise, too, shape (n, m),
and one that plans h actions in a row returns shape (n, h, k).
"""

import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.export_formats import POLICY_FORMATS, Inputs
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.errors import ExportError, LayoutError, UsageError
from marl_mm.files import new_file
from marl_mm.layout import Layout, in_order
from marl_mm.received import check_regular, parse_json
from marl_mm.versions import refuse_missing

TOLERANCE = 1e-5
"""Largest difference between a file's actions and the policy's, in halves of the
actions' range."""

_CHECKS = 200
"""Observations at which they are compared."""


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
        The file's metadata, and the largest difference found, as ``TOLERANCE``.

    Raises:
        UsageError: If there is no such agent, or a library is missing.
        ExportError: If the file's actions differ by more than ``TOLERANCE``.
        OSError: If there is no room for the file; it names the file.
    """
    chosen = POLICY_FORMATS.get(form)
    refuse_missing(form, chosen.packages)
    module = _Exported(policy, agent).eval()
    metadata = module.metadata | {"policy": policy.name, "weights": policy.fingerprint}
    inputs = module.some(_CHECKS)
    with new_file(path) as temporary:
        with _quiet():
            few = tuple(values[:2] for values in inputs)
            run = chosen.write(module, few, temporary, metadata)
        difference = largest_difference(run(inputs), module.expected(*inputs), metadata)
        if not difference <= TOLERANCE:
            raise ExportError(
                f"the exported policy's actions differ from the run's by "
                f"{difference:.2g} of half their range, expected at most "
                f"{TOLERANCE:g}: no file was written"
            )
    return metadata | {"largest_difference": difference}


def largest_difference(
    actions: np.ndarray, others: np.ndarray, metadata: Mapping[str, Any]
) -> float:
    """Largest difference of actions, shape (..., k), in halves of their range.

    Args:
        actions: Actions.
        others: Actions that they are compared with.
        metadata: Metadata of the file, with the actions' bounds.
    """
    low, high = (np.array(metadata[f"action_{end}"]) for end in ("low", "high"))
    return float((np.abs(actions - others) / ((high - low) / 2)).max())


def signature(metadata: Mapping[str, Any]) -> str:
    """What an exported policy takes and returns, in words."""
    noise = f", {metadata['noise']} of noise" if "noise" in metadata else ""
    plan = f"{metadata['chunk']} steps of " if "chunk" in metadata else ""
    entries, actions = (", ".join(metadata[n]) for n in ("observation", "action"))
    return f"{entries}{noise} -> {plan}{actions}"


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
    refuse_missing(name, form.packages)
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
