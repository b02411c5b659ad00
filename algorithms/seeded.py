"""Actors and critics of several seeds that learn side by side, as if each were alone.

Tensors have the seeds in front: shape (S, B, ...). On a CPU there is one seed to a
process; on a GPU, many seeds take hardly longer than one.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import nn

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.ensemble import Ensemble, Learner
from marl_mm.algorithms.networks import Actor, Normalizer, perceptron
from marl_mm.layout import ACTION, STATE, AgentLayout

TWINS = 2
"""Critics of a pair (Fujimoto 2018)."""

DIAGNOSED = 1_024
"""Transitions that diagnostics look at."""

_SATURATED = 0.98
"""Beyond this an action counts as saturated, in [-1, 1] coordinates."""


class SeededActors:
    """Every seed's actors, one per agent, on normalised joint states.

    Args:
        layouts: What each agent sees and sets; together they set the joint action.
        normalizer: Of joint states.
        hidden: Units of the hidden layers.
        rate: Learning rate.
        seeds: Of initial weights, S of them.
        device: Where they go.
    """

    def __init__(
        self,
        layouts: Sequence[AgentLayout],
        normalizer: Normalizer,
        hidden: Sequence[int],
        rate: float,
        seeds: Sequence[int],
        device: str,
    ) -> None:
        self._layouts = {layout.name: layout for layout in layouts}
        self._normalizer, self._hidden = normalizer, hidden
        members: dict[str, list[nn.Sequential]] = {name: [] for name in self._layouts}
        for seed in seeds:
            with _seeded(seed, 0):
                for name, agent in self._layouts.items():
                    widths = len(agent.observation), *hidden, len(agent.action)
                    members[name].append(nn.Sequential(*perceptron(widths)))
        self.networks = {name: Ensemble(m, device) for name, m in members.items()}
        self.targets = {name: one.copy() for name, one in self.networks.items()}
        self._learners = {n: Learner(one, rate) for n, one in self.networks.items()}

    def own(self, name: str, state: torch.Tensor) -> torch.Tensor:
        """One agent's actions in [-1, 1], shape (S, B, k)."""
        entries = self._layouts[name].observation
        return torch.tanh(self.networks[name](_columns(state, entries)))

    def joint(self, state: torch.Tensor) -> torch.Tensor:
        """All agents' actions, shape (S, B, 4)."""
        return torch.cat([self.own(name, state) for name in self._layouts], dim=-1)

    def joint_target(self, state: torch.Tensor) -> torch.Tensor:
        """What the target actors would do, shape (S, B, 4)."""
        parts = [
            self.targets[name](_columns(state, layout.observation))
            for name, layout in self._layouts.items()
        ]
        return torch.tanh(torch.cat(parts, dim=-1))

    def descend(self, name: str, loss: torch.Tensor) -> None:
        """One step of one agent's actors down their losses, shape (S,)."""
        self._learners[name].descend(loss.sum())

    def follow(self, rate: float) -> None:
        """Bring the target actors nearer."""
        for name, target in self.targets.items():
            target.follow(self.networks[name], rate)

    def diagnose(
        self, state: torch.Tensor, action: torch.Tensor
    ) -> dict[str, torch.Tensor]:
        """Mean square difference to actions of the data by entry, and saturation.

        Args:
            state: Normalised, shape (1, n, 10).
            action: In [-1, 1], shape (1, n, 4).
        """
        seeds = len(next(iter(self.networks.values())).weights["0.bias"])
        now = self.joint(state.expand(seeds, -1, -1))
        errors = (now - action).square().mean(dim=1)
        return {
            **{f"imitation/{name}": errors[:, i] for i, name in enumerate(ACTION)},
            "action/saturation": (now.abs() > _SATURATED).float().mean(dim=(1, 2)),
        }

    def agents(self, number: int) -> dict[str, AgentActor]:
        """One seed's actors, on the CPU, with the input statistics within."""
        found = {}
        for name, layout in self._layouts.items():
            entries = list(layout.observation)
            mean, std = self._normalizer.mean.cpu(), self._normalizer.std.cpu()
            normalizer = Normalizer(mean[entries], std[entries])
            actor = Actor(normalizer, len(layout.action), self._hidden)
            actor.layers.load_state_dict(self.networks[name].member(number))
            found[name] = AgentActor(layout, actor)
        return found

    def state(self, number: int) -> dict[str, Any]:
        """One seed's part of a checkpoint."""
        agents = self.agents(number)
        return {
            "actors": {name: one.actor.state_dict() for name, one in agents.items()},
            "target_actors": {n: t.member(number) for n, t in self.targets.items()},
            "actor_learners": {n: o.member(number) for n, o in self._learners.items()},
        }

    def load_state(self, number: int, state: Mapping[str, Any]) -> None:
        """Continue with one seed from its ``state``."""
        for name, network in self.networks.items():
            actor = state["actors"][name].items()
            prefix = "layers."
            layers = {k.removeprefix(prefix): v for k, v in actor if prefix in k}
            network.load_member(number, layers)
            self.targets[name].load_member(number, state["target_actors"][name])
            self._learners[name].load_member(number, state["actor_learners"][name])


class SeededCritics:
    """Every seed's pairs of critics of joint actions at normalised joint states.

    Args:
        pairs: How many pairs a seed has.
        hidden: Units of the hidden layers.
        layer_norm: Whether these are normalised.
        rate: Learning rate.
        seeds: Of initial weights, S of them.
        device: Where they go.
    """

    def __init__(
        self,
        pairs: int,
        hidden: Sequence[int],
        layer_norm: bool,
        rate: float,
        seeds: Sequence[int],
        device: str,
    ) -> None:
        self._pairs, self._each = pairs, pairs * TWINS
        widths = len(STATE) + len(ACTION), *hidden, 1
        members = []
        for seed in seeds:
            with _seeded(seed, 1):
                members += [
                    nn.Sequential(*perceptron(widths, layer_norm=layer_norm))
                    for _ in range(self._each)
                ]
        self.networks = Ensemble(members, device)
        self.targets = self.networks.copy()
        self._learner = Learner(self.networks, rate)

    def values(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """What all critics say, shape (S, pairs, 2, B)."""
        return self._all(self.networks, state, action)

    def least_target(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """The lower value of each pair of target critics, shape (S, pairs, B)."""
        values = self._all(self.targets, state, action)
        return torch.minimum(values[:, :, 0], values[:, :, 1])

    def first(
        self, state: torch.Tensor, action: torch.Tensor, pair: int = 0
    ) -> torch.Tensor:
        """What the first critic of a pair says, shape (S, B)."""
        chosen = slice(pair * TWINS, None, self._each)
        inputs = torch.cat([state, action], dim=-1)
        return self.networks(inputs, chosen).squeeze(-1)

    def descend(self, loss: torch.Tensor) -> None:
        """One step of all critics down their losses, shape (S,)."""
        self._learner.descend(loss.sum())

    def follow(self, rate: float) -> None:
        """Bring the target critics nearer."""
        self.targets.follow(self.networks, rate)

    def state(self, number: int) -> dict[str, Any]:
        """One seed's part of a checkpoint."""
        return {
            name: [part.member(i) for i in self._members(number)]
            for name, part in self._parts().items()
        }

    def load_state(self, number: int, state: Mapping[str, Any]) -> None:
        """Continue with one seed from its ``state``."""
        for name, part in self._parts().items():
            for i, own in zip(self._members(number), state[name], strict=True):
                part.load_member(i, own)

    def _all(
        self, networks: Ensemble, state: torch.Tensor, action: torch.Tensor
    ) -> torch.Tensor:
        inputs = torch.cat([state, action], dim=-1)
        seeds, size, width = inputs.shape
        each = inputs[:, None].expand(seeds, self._each, size, width)
        values = networks(each.reshape(seeds * self._each, size, width))
        return values.view(seeds, self._pairs, TWINS, size)

    def _parts(self) -> dict[str, Ensemble | Learner]:
        return {
            "critics": self.networks,
            "target_critics": self.targets,
            "critic_learners": self._learner,
        }

    def _members(self, number: int) -> range:
        return range(number * self._each, (number + 1) * self._each)


def _columns(state: torch.Tensor, entries: tuple[int, ...]) -> torch.Tensor:
    return state if len(entries) == len(STATE) else state[..., list(entries)]


@contextmanager
def _seeded(seed: int, stream: int) -> Iterator[None]:
    """Let torch's own generator, which initial weights come from, begin anew."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(2 * seed + stream)
        yield
