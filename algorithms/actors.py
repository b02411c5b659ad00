"""Actors: each with its own observation and its place in the joint action."""

import pickle
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import nn

from marl_mm.algorithms.config_checks import MOST_FLOW_STEPS
from marl_mm.algorithms.networks import (
    PLAIN,
    ActionScale,
    Actor,
    Form,
    Normalizer,
)
from marl_mm.errors import UsageError
from marl_mm.layout import JOINT_NAME, AgentLayout, Layout, in_order


class AgentActor:
    """One agent's actor with its place in the joint state and action.

    Args:
        layout: Layout of the agent.
        actor: Network of the agent.

    Raises:
        UsageError: If the network is no ``Actor``, which checkpoints rebuild.
    """

    def __init__(self, layout: AgentLayout, actor: Actor) -> None:
        if not isinstance(actor, Actor):
            raise UsageError(
                f"the network of {layout.name!r} is {type(actor).__name__}, expected "
                "marl_mm.algorithms.networks.Actor, which checkpoints can hold"
            )
        self.layout = layout
        self.actor = actor
        self._entries = torch.tensor(layout.observation)
        self._sees_all = layout.observation == tuple(range(len(layout.observation)))
        self.scale = ActionScale(torch.tensor(layout.low), torch.tensor(layout.high))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by value: torch would share weights that go on learning."""
        return _revived, (self.layout, pickle.dumps(self.actor))

    def observed(self, state: torch.Tensor) -> torch.Tensor:
        """Agent's observations of joint states, shapes (..., n) to (..., d)."""
        if self._sees_all and len(self._entries) == state.shape[-1]:
            return state
        return state.index_select(-1, self._entries)

    @torch.no_grad()
    def plan(
        self,
        observation: np.ndarray,
        noise: np.ndarray | torch.Tensor | None = None,
    ) -> np.ndarray:
        """Next actions in the action space, shape (h, k); most actors plan one.

        Args:
            observation: The agent's own observation, shape (d,).
            noise: Standard normal noise of actors that take some, shape (m,).
        """
        inputs = torch.as_tensor(observation, dtype=torch.float32)
        drawn = None if noise is None else torch.as_tensor(noise, dtype=torch.float32)
        flows = type(self.actor) is Actor and self.actor.form.flow_steps > 0
        if drawn is not None and flows:
            action = self._flow(self.actor.normalizer(inputs), drawn)
        else:
            action = self.actor(inputs, drawn)
        planned: np.ndarray = self.planned(action).numpy()
        return planned

    def _flow(self, observed: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """``Form.act`` of a flow for one observation, in less time.

        Torch takes longer to begin a product this small than NumPy does for all of it.
        """
        seen, steps = observed.shape[-1], self.actor.form.flow_steps
        action = noise.numpy()
        inputs = np.empty(seen + len(action) + 1, np.float32)
        inputs[:seen] = observed.numpy()
        *inner, (weight, bias) = self._layers
        for step in range(steps):
            inputs[seen:-1], inputs[-1] = action, step / steps
            hidden = inputs
            for weights, biases in inner:
                hidden = np.maximum(weights @ hidden + biases, 0)
            action = action + (weight @ hidden + bias) / np.float32(steps)
        return torch.from_numpy(action.clip(-1, 1))

    @cached_property
    def _layers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Weights and biases of the actor's layers, which go on learning."""
        linear = (m for m in self.actor.layers if isinstance(m, nn.Linear))
        return [(m.weight.detach().numpy(), m.bias.detach().numpy()) for m in linear]

    def planned(self, action: torch.Tensor) -> torch.Tensor:
        """Actions of the network in the action space, (..., h k) to (..., h, k)."""
        chunks = action.reshape(*action.shape[:-1], -1, len(self.layout.action))
        return self.scale.denormalize(chunks)


def _revived(layout: AgentLayout, actor: bytes) -> AgentActor:
    return AgentActor(layout, pickle.loads(actor))


def blank_actor(
    agent: AgentLayout, hidden: Sequence[int], form: Form = PLAIN
) -> AgentActor:
    """Untrained actor without input statistics."""
    normalizer = Normalizer.blank(len(agent.observation))
    return AgentActor(agent, Actor(normalizer, form.widths(agent, hidden), form))


def actors_from(states: Mapping[str, Any], layout: Layout) -> dict[str, AgentActor]:
    """Trained actors from their networks' states, of one joint agent or of several.

    Raises:
        ValueError: If a number is not finite, or a standard deviation not positive.
        KeyError, TypeError, AttributeError, RuntimeError: If a state is none, or of
            other networks.
    """
    agents = {}
    for agent in (layout.joint,) if JOINT_NAME in states else layout.agents:
        state = states[agent.name]
        agents[agent.name] = blank_actor(agent, *_hidden_and_form(agent, state))
        actor = agents[agent.name].actor
        for key, blank in actor.state_dict().items():
            if key in state and state[key].dtype != blank.dtype:  # it would be cast
                raise ValueError(
                    f"{key} of type {state[key].dtype}, expected {blank.dtype}"
                )
        actor.load_state_dict(state)
        actor.eval()
        if not all(bool(value.isfinite().all()) for value in state.values()):
            raise ValueError(f"weights of {agent.name} that are NaN or infinite")
        if not bool((actor.normalizer.std > 0).all()):
            raise ValueError(f"standard deviations of {agent.name} that are not > 0")
    return agents


def joint_action(agents: Mapping[str, AgentActor], state: torch.Tensor) -> torch.Tensor:
    """All actors' actions at joint states, shapes (m, n) to (m, k), in [-1, 1]."""
    parts = [agent.actor(agent.observed(state)) for agent in agents.values()]
    joined = torch.cat(parts, dim=-1)
    order = in_order(agent.layout for agent in agents.values())
    return joined if order is None else joined[..., order]


def _hidden_and_form(
    agent: AgentLayout, state: Mapping[str, torch.Tensor]
) -> tuple[list[int], Form]:
    """Units of an actor's hidden layers, and its form, from its state."""
    weights = {
        int(key.split(".")[1]): value  # files have names in the order of the alphabet
        for key, value in state.items()
        if key.startswith("layers.") and value.dim() == 2
    }
    *hidden, outputs = (weights[number].shape[0] for number in sorted(weights))
    steps = int(state.get("flow_steps", torch.tensor(0)))
    if not 0 <= steps <= MOST_FLOW_STEPS:
        raise ValueError(f"flow_steps {steps} of {agent.name}")
    chunk = outputs // len(agent.action)
    return hidden, Form("flow_steps" in state, steps, chunk)
