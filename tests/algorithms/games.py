"""Games of one or two steps whose solutions are known by hand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.registry import ALGORITHMS, TUNED
from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.episode import Episode
from marl_mm.layout import Agent, Entry, Layout


def team(agents: int = 2) -> Layout:
    """Agents of one action each, and a state of place and goal that all of them see."""
    state = Entry("place", "m"), Entry("goal", "m")
    actions = tuple(Entry(f"a_{i}", "1", -1.0, 1.0) for i in range(agents))
    members = tuple(
        Agent(f"agent_{i}", ("place", "goal"), (f"a_{i}",)) for i in range(agents)
    )
    return Layout(state, actions, members, ("place",), ("goal",))


@dataclass(frozen=True)
class NoJudge:
    """Judge of games whose goals are never exchanged."""

    highest_return: float | None = None
    needs: tuple[str, ...] = ()

    def judge(self, achieved: np.ndarray, *_: Any) -> tuple[np.ndarray, np.ndarray]:
        assert len(achieved) == 0, "goals were exchanged"
        return np.zeros(0), np.zeros(0, bool)


def steps_of(
    actions: np.ndarray, rewards: np.ndarray, layout: Layout, length: int = 1
) -> EpisodeArrays:
    """Episodes of this many steps each; the place is the number of the step.

    Args:
        actions: Actions, shape (n length, k).
        rewards: Rewards, shape (n length,).
        layout: Layout of them, as of ``team``.
        length: Steps of an episode.
    """
    episodes = []
    for number in range(len(rewards) // length):
        rows = slice(number * length, (number + 1) * length)
        ended = np.arange(length) == length - 1
        places = np.arange(length + 1.0)
        episodes.append(
            Episode(
                states=np.stack([places, np.zeros(length + 1)], axis=1),
                actions=actions[rows].astype(np.float32),
                rewards=rewards[rows].astype(float),
                terminated=ended,
                truncated=np.zeros(length, bool),
                info={"is_success": ended & (rewards[rows] > 0)},
                layout=layout,
                seed=number,
                index=number,
                source="game",
                start=np.zeros(11),
            )
        )
    return arrays_of(episodes, "game")


def learner_of(
    name: str,
    arrays: EpisodeArrays,
    updates: int = 600,
    seeds: Sequence[int] = (0,),
    **changes: Any,
) -> Any:
    """The learner of an algorithm after some updates on a game."""
    algorithm = ALGORITHMS.get(name)
    usual: dict[str, Any] = {
        "hidden": (32, 32),
        "batch_size": 64,
        "precision": "highest",
    }
    config = replace(algorithm.presets[TUNED], **usual | changes)
    learner = algorithm.learner(config, arrays, NoJudge(), seeds, "cpu")
    for _ in range(updates):
        learner.update()
    return learner


def learnt(
    name: str, arrays: EpisodeArrays, updates: int = 600, **changes: Any
) -> LearnedPolicy:
    """The policy of an algorithm after some updates on a game."""
    learner = learner_of(name, arrays, updates, **changes)
    return LearnedPolicy(name, learner.agents(0), learner.layout)


def played(
    policy: LearnedPolicy, episodes: int = 200, states: Sequence[Any] = ((0.0, 0.0),)
) -> np.ndarray:
    """Actions of many episodes, shape (episodes, steps, k).

    Args:
        policy: Policy.
        episodes: Number of episodes, each of a seed of its own.
        states: Joint states of the steps.
    """
    acted = []
    for seed in range(episodes):
        policy.begin(np.random.default_rng(seed), policy.layout)
        acted.append([policy.act(np.array(state)) for state in states])
    return np.array(acted)


def same_state(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    """Whether two states of a learner hold the same numbers, whatever their names."""
    here, there = list(_tensors(first)), list(_tensors(second))
    return len(here) == len(there) and all(map(torch.equal, here, there))


def _tensors(state: Any) -> Any:
    if isinstance(state, torch.Tensor):
        yield state
    elif isinstance(state, Mapping | list):
        for part in state.values() if isinstance(state, Mapping) else state:
            yield from _tensors(part)
