"""Algorithms under test: small learners on little data, and what they hold."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from marl_mm.algorithms.checkpoint import checkpoint, save_seed
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, Algorithm
from marl_mm.contracts.claims import demand, demand_same
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.envs.registry import make_task
from marl_mm.files import write_bytes
from marl_mm.layout import Agent, Layout

UPDATES = 7
"""Updates between the points that claims compare; no period of an update divides it."""

UNUSUAL = "three agents whose entries are in another order"
"""Name of the team that differs most from the usual one."""


@dataclass(frozen=True)
class Candidate:
    """An algorithm under test; ``learner`` below is a learner that ``fresh`` made."""

    name: str
    """Registered name."""

    algorithm: Algorithm
    """The algorithm."""

    @property
    def online(self) -> bool:
        """Whether it learns from an environment."""
        return self.algorithm.online

    @property
    def config(self) -> Any:
        """Hyper-parameters that are quick, where they have the usual names."""
        config = self.algorithm.presets[TUNED]
        small = {
            "hidden": (16,),
            "batch_size": 16,
            "precision": "highest",
            "warm_up": 8,
            "capacity": 2_000,
        }
        names = {field.name for field in fields(config)}
        return replace(config, **{k: v for k, v in small.items() if k in names})

    def fresh(
        self,
        arrays: EpisodeArrays,
        seeds: tuple[int, ...] = (0,),
        device: str = "cpu",
    ) -> Any:
        """A new learner; an online one has seen the episodes."""
        torch.set_num_threads(1)
        task, make = make_task(), self.algorithm.learner
        if not self.online:
            return make(self.config, arrays, task, seeds, device)
        learner = make(self.config, task, seeds[0], (), arrays.layout)
        for number in range(len(arrays)):
            learner.observe(arrays.episode(number))
        return learner

    def trained(
        self,
        arrays: EpisodeArrays,
        seeds: tuple[int, ...] = (0,),
        updates: int = UPDATES,
        device: str = "cpu",
    ) -> Any:
        """A new learner after some updates."""
        learner = self.fresh(arrays, seeds, device)
        self.train(learner, updates)
        return learner

    def train(self, learner: Any, updates: int = UPDATES) -> None:
        """Make some updates."""
        if self.online:
            learner.learn(updates)
        else:
            for _ in range(updates):
                learner.update()

    def agents(self, learner: Any, number: int = 0) -> Any:
        """The actors of the learner's seed of this number, by agent."""
        return learner.agents if self.online else learner.agents(number)

    def policy(self, learner: Any) -> LearnedPolicy:
        """The policy of the learner's first seed."""
        return LearnedPolicy(self.name, self.agents(learner), learner.layout)

    def weights(self, learner: Any, number: int = 0) -> dict[str, np.ndarray]:
        """Copies of the actors' weights, by agent and parameter, and no scales."""
        return {
            f"{name} {key}": value.detach().numpy().copy()
            for name, agent in self.agents(learner, number).items()
            for key, value in agent.actor.named_parameters()
        }

    def state(self, learner: Any) -> Any:
        """Everything that the learner's first seed needs to resume."""
        return learner.state() if self.online else learner.state(0)

    def save(self, path: Path, learner: Any) -> None:
        """Write a checkpoint of the learner's first seed."""
        if self.online:
            write_bytes(path, checkpoint(learner))
        else:
            save_seed(path, learner, 0)


def candidate(name: str) -> Candidate:
    """A registered algorithm, to be tested."""
    return Candidate(name, ALGORITHMS.get(name))


def some_episodes() -> EpisodeArrays:
    """Sixteen episodes of the dataset that ships, some as if cut off or failed."""
    arrays = shipped_arrays().select(range(16))
    last = np.cumsum(arrays.lengths) - 1
    arrays.terminated[last[3::6]], arrays.truncated[last[3::6]] = False, True
    arrays.info["is_success"][last[[*range(3, 16, 6), 7]]] = False
    return arrays


def several_layouts(arrays: EpisodeArrays) -> dict[str, EpisodeArrays]:
    """The same episodes as seen by other teams, with entries in another order."""
    usual = arrays.layout
    order = [*range(len(usual.state))][::-1]
    names = usual.state_names
    three = Layout(
        tuple(usual.state[i] for i in order),
        usual.action,
        (
            Agent("last", names[:3], usual.action_names[3:]),
            Agent("middle", names[2:9], usual.action_names[1:3][::-1]),
            Agent("first", (names[9], names[0]), usual.action_names[:1]),
        ),
        usual.compared,
        usual.desired,
    )
    alone = replace(usual, team=(Agent("all", names, usual.action_names),))
    return {
        "two agents": arrays,
        UNUSUAL: replace(arrays, states=arrays.states[:, order], layout=three),
        "one agent": replace(arrays, layout=alone),
    }


def demand_same_state(first: Any, second: Any) -> None:
    """Raise unless two states of learners are equal to the bit.

    Raises:
        BrokenClaimError: Naming a tensor or number that differs.
    """
    here, there = _flat(first), _flat(second)
    demand(here.keys() == there.keys(), "states have other keys")
    for key, value in here.items():
        if isinstance(value, torch.Tensor):
            then = there[key].cpu().numpy()
            demand_same(value.cpu().numpy(), then, f"values of {key}")
        else:
            demand(value == there[key], f"{key} is {value}, then {there[key]}")


def _flat(state: Any, path: str = "state") -> dict[str, Any]:
    """Tensors and numbers of a nested state by their paths."""
    if isinstance(state, Mapping):
        parts = {f"{path}.{key}": value for key, value in state.items()}
    elif isinstance(state, list | tuple):
        parts = {f"{path}.{i}": value for i, value in enumerate(state)}
    else:
        return {path: state}
    return {key: v for p, part in parts.items() for key, v in _flat(part, p).items()}
