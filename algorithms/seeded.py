"""Actors and critics of several seeds that learn side by side, as if each were alone.

Tensors have the seeds in front: shape (S, B, ...). On a CPU there is one seed to a
process; on a GPU, many seeds take hardly longer than one.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from typing import Any

import torch
from torch import nn

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.ensemble import Ensemble, Learner
from marl_mm.algorithms.networks import PLAIN, Actor, Form, Normalizer, perceptron
from marl_mm.layout import AgentLayout, columns, in_order

TWINS = 2
"""Critics of a pair (Fujimoto 2018)."""


class SeededActors:
    """Every seed's actors, one per agent, on normalised joint states.

    Args:
        layouts: Layouts of the agents, which together set the joint action.
        normalizer: Normalizer of joint states.
        hidden: Units of the hidden layers.
        rate: Learning rate.
        seeds: Seeds of initial weights, S of them.
        device: Device of the networks.
        form: Form of the networks.
        stream: Stream of initial weights: 0, or 1, which critics have. A flow beside
            actors has their stream, whose numbers fall into other places there.
    """

    learns = True
    """Whether the networks learn; targets do not."""

    def __init__(
        self,
        layouts: Sequence[AgentLayout],
        normalizer: Normalizer,
        hidden: Sequence[int],
        rate: float,
        seeds: Sequence[int],
        device: str,
        form: Form = PLAIN,
        stream: int = 0,
    ) -> None:
        self._layouts = {layout.name: layout for layout in layouts}
        self._order = in_order(layouts)
        self._normalizer, self._hidden = normalizer, hidden
        self.form = form
        members: dict[str, list[nn.Sequential]] = {name: [] for name in self._layouts}
        for seed in seeds:
            with _seeded(seed, stream):
                for name, agent in self._layouts.items():
                    widths = form.widths(agent, hidden)
                    members[name].append(nn.Sequential(*perceptron(widths)))
        self.networks = {name: Ensemble(m, device) for name, m in members.items()}
        self._learners = {n: Learner(net, rate) for n, net in self.networks.items()}

    def observed(self, name: str, state: torch.Tensor) -> torch.Tensor:
        """What an agent sees of joint states, shape (S, B, d)."""
        return state[..., columns(self._layouts[name].observation)]

    def action(
        self, name: str, state: torch.Tensor, noise: torch.Tensor | None = None
    ) -> torch.Tensor:
        """One agent's actions in [-1, 1], shape (S, B, k).

        Args:
            name: Name of the agent.
            state: Normalised joint states.
            noise: The agent's noise, shape (S, B, k), if the form is noisy.
        """
        return self.form.act(self.networks[name], self.observed(name, state), noise)

    def joint(
        self, state: torch.Tensor, noise: torch.Tensor | None = None
    ) -> torch.Tensor:
        """All agents' actions, shape (S, B, k); noise is in the order of entries."""
        parts = []
        for name, layout in self._layouts.items():
            own = None if noise is None else noise[..., self.entries(layout)]
            parts.append(self.action(name, state, own))
        return self.joined(parts)

    def joined(self, parts: Sequence[torch.Tensor]) -> torch.Tensor:
        """Joint actions of all agents' parts, in the agents' order."""
        if self._order is None and self.form.chunk == 1:
            return torch.cat(list(parts), dim=-1)
        return _chunked(parts, self.form.chunk, self._order)

    def entries(self, agent: AgentLayout) -> slice | list[int]:
        """Columns of an agent's actions among the joint ones, chunk after chunk."""
        if self.form.chunk == 1:
            return columns(agent.action)
        width = sum(len(layout.action) for layout in self._layouts.values())
        chunks = range(self.form.chunk)
        return [width * h + entry for h in chunks for entry in agent.action]

    def descend(self, name: str, loss: torch.Tensor) -> None:
        """One gradient step of an agent's actors.

        Args:
            name: Name of the agent.
            loss: Losses of the seeds, shape (S,).
        """
        self._learners[name].descend(loss.sum())

    def copy(self) -> "SeededActors":
        """Target actors: equal now, and without learners."""
        other = copy(self)
        other.networks = {name: net.copy() for name, net in self.networks.items()}
        other._learners, other.learns = {}, False
        return other

    def follow(self, others: "SeededActors", rate: float) -> None:
        """Move by a share of the way to the others' weights."""
        for name, network in self.networks.items():
            network.follow(others.networks[name], rate)

    def agents(self, number: int) -> dict[str, AgentActor]:
        """Actors of one seed on the CPU, with their input statistics."""
        actors = {}
        for name, layout in self._layouts.items():
            entries = list(layout.observation)
            mean, std = self._normalizer.mean.cpu(), self._normalizer.std.cpu()
            normalizer = Normalizer(mean[entries], std[entries])
            widths = self.form.widths(layout, self._hidden)
            actor = Actor(normalizer, widths, self.form)
            actor.layers.load_state_dict(self.networks[name].member(number))
            actors[name] = AgentActor(layout, actor)
        return actors

    def state(self, number: int) -> dict[str, Any]:
        """State of one seed's actors, with their input statistics."""
        agents = self.agents(number)
        return {name: agent.actor.state_dict() for name, agent in agents.items()}

    def load_state(self, number: int, state: Mapping[str, Any]) -> None:
        """Load one seed's actors from a ``state``."""
        prefix = "layers."
        for name, network in self.networks.items():
            actor = state[name].items()
            layers = {k.removeprefix(prefix): v for k, v in actor if prefix in k}
            network.load_member(number, layers)

    def learner_state(self, number: int) -> dict[str, Any]:
        """State of one seed's learners, by agent."""
        return {n: learner.member(number) for n, learner in self._learners.items()}

    def load_learner_state(self, number: int, state: Mapping[str, Any]) -> None:
        """Load one seed's learners from a ``learner_state``."""
        for name, learner in self._learners.items():
            learner.load_member(number, state[name])


class SeededCritics:
    """Every seed's pairs of critics of joint actions at normalised joint states.

    Args:
        inputs: Number of entries of state and action.
        pairs: Number of pairs of a seed.
        hidden: Units of the hidden layers.
        layer_norm: Whether hidden layers are normalised.
        rate: Learning rate.
        seeds: Seeds of initial weights, S of them.
        device: Device of the networks.
        twins: Critics of a pair.
        stream: Stream of initial weights, 0 or 1. A state's value beside critics has
            theirs, whose numbers fall into other places there.
    """

    learns = True
    """Whether the networks learn; targets do not."""

    def __init__(
        self,
        inputs: int,
        pairs: int,
        hidden: Sequence[int],
        layer_norm: bool,
        rate: float,
        seeds: Sequence[int],
        device: str,
        twins: int = TWINS,
        stream: int = 1,
    ) -> None:
        self._pairs, self._twins, self._each = pairs, twins, pairs * twins
        widths = inputs, *hidden, 1
        members = []
        for seed in seeds:
            with _seeded(seed, stream):
                members += [
                    nn.Sequential(*perceptron(widths, layer_norm=layer_norm))
                    for _ in range(self._each)
                ]
        self.networks = Ensemble(members, device)
        self._learner = Learner(self.networks, rate)

    def values(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Values by all critics, shape (S, pairs, twins, B)."""
        inputs = torch.cat([state, action], dim=-1)
        seeds, size, width = inputs.shape
        each = inputs[:, None].expand(seeds, self._each, size, width)
        values = self.networks(each.reshape(seeds * self._each, size, width))
        return values.view(seeds, self._pairs, self._twins, size)

    def least(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """The lower value of each pair, shape (S, pairs, B)."""
        return self.values(state, action).amin(dim=2)

    def first(
        self, state: torch.Tensor, action: torch.Tensor, pair: int = 0
    ) -> torch.Tensor:
        """Value by the first critic of a pair, shape (S, B)."""
        chosen = slice(pair * self._twins, None, self._each)
        inputs = torch.cat([state, action], dim=-1)
        return self.networks(inputs, chosen).squeeze(-1)

    def descend(self, loss: torch.Tensor) -> None:
        """One gradient step of all critics, with losses of shape (S,)."""
        self._learner.descend(loss.sum())

    def copy(self) -> "SeededCritics":
        """Target critics: equal now, and without a learner."""
        other = copy(self)
        other.networks = self.networks.copy()
        del other._learner
        other.learns = False
        return other

    def follow(self, others: "SeededCritics", rate: float) -> None:
        """Move by a share of the way to the others' weights."""
        self.networks.follow(others.networks, rate)

    def state(self, number: int) -> list[Any]:
        """State of one seed's critics."""
        return [self.networks.member(i) for i in self._members(number)]

    def load_state(self, number: int, state: Sequence[Any]) -> None:
        """Load one seed's critics from a ``state``."""
        for i, values in zip(self._members(number), state, strict=True):
            self.networks.load_member(i, values)

    def learner_state(self, number: int) -> list[Any]:
        """State of the learner for one seed's critics."""
        return [self._learner.member(i) for i in self._members(number)]

    def load_learner_state(self, number: int, state: Sequence[Any]) -> None:
        """Load the learner for one seed's critics from a ``learner_state``."""
        for i, values in zip(self._members(number), state, strict=True):
            self._learner.load_member(i, values)

    def _members(self, number: int) -> range:
        return range(number * self._each, (number + 1) * self._each)


Part = SeededActors | SeededCritics
"""Networks of a learner."""

Parts = Mapping[str, Part]
"""Networks of a learner by their name in its state."""


def parts_state(parts: Parts, number: int) -> dict[str, Any]:
    """State of one seed's networks, and of their learners where they learn."""
    state: dict[str, Any] = {}
    for name, part in parts.items():
        state[name] = part.state(number)
        if part.learns:
            state[_learners(name)] = part.learner_state(number)
    return state


def load_parts(parts: Parts, states: Sequence[Mapping[str, Any]]) -> None:
    """Load all networks from every seed's ``parts_state``."""
    for number, state in enumerate(states):
        for name, part in parts.items():
            part.load_state(number, state[name])
            if part.learns:
                part.load_learner_state(number, state[_learners(name)])


def _learners(name: str) -> str:
    return f"{name.removesuffix('s')}_learners"


def _chunked(parts: Sequence[torch.Tensor], chunk: int, order: Any) -> torch.Tensor:
    """Joint actions of agents' chunks, chunk after chunk."""
    rows = [part.reshape(*part.shape[:-1], chunk, -1) for part in parts]
    joined = torch.cat(rows, dim=-1)
    joined = joined if order is None else joined[..., order]
    return joined.flatten(-2)


@contextmanager
def _seeded(seed: int, stream: int) -> Iterator[None]:
    """Seed torch's own generator, which draws initial weights, for a block.

    It tells apart what differs in 32 bits: seeds are below ``SEEDS_OF_RUNS``.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(2 * seed + stream)
        yield
