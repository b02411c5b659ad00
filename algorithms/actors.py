"""Actors: each with its own observation and its place in the joint action."""

import pickle
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from marl_mm.algorithms.networks import ActionScale, Actor, Normalizer
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
    def act(self, observation: np.ndarray) -> np.ndarray:
        """Action in the action space, shape (k,), at the agent's own observation."""
        inputs = torch.as_tensor(observation, dtype=torch.float32)
        action: np.ndarray = self.scale.denormalize(self.actor(inputs)).numpy()
        return action


def _revived(layout: AgentLayout, actor: bytes) -> AgentActor:
    return AgentActor(layout, pickle.loads(actor))


def blank_actor(agent: AgentLayout, hidden: Sequence[int]) -> AgentActor:
    """Untrained actor without input statistics."""
    normalizer = Normalizer.blank(len(agent.observation))
    return AgentActor(agent, Actor(normalizer, len(agent.action), hidden))


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
        agents[agent.name] = blank_actor(agent, _hidden(state))
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


def _hidden(state: Mapping[str, torch.Tensor]) -> list[int]:
    """Units of an actor's hidden layers, from its weights."""
    weights = [v for k, v in state.items() if k.startswith("layers.") and v.dim() == 2]
    return [weight.shape[0] for weight in weights[:-1]]
