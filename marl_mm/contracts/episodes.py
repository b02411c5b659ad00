"""Tasks under test: short episodes of them, with random actions."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from marl_mm.contracts.claims import demand
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.envs.rollout import EpisodePlan, episode_seed, run_episode
from marl_mm.envs.task import Task
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.layout import Layout
from marl_mm.sim.config import engine_overrides

EPISODES = 3
"""Number of episodes that a claim looks at."""


@dataclass(frozen=True)
class ShortTask:
    """A task with few steps, of a tenth of a second where its numbers allow it."""

    name: str
    """Registered name."""

    task: Task
    """The shortened task."""

    overrides: Mapping[str, Any]
    """Fields of the task that were replaced."""

    @cached_property
    def episodes(self) -> list[Episode]:
        """Its first random episodes, for the claims that only read them."""
        return episodes(self)


def short(name: str) -> ShortTask:
    """A registered task, shortened, on MuJoCo: fast, and there with every Python."""
    own, engine = TASKS.get(name).max_steps, engine_overrides("mujoco")
    for ticks, steps in ((24, 5), (24, 10), (24, own), (240, 5)):
        overrides = {"ticks_per_step": ticks, "max_steps": steps, **engine}
        try:
            return ShortTask(name, make_task(name, overrides), overrides)
        except UsageError:  # such as a goal that is further away
            continue
    return ShortTask(name, make_task(name, engine), engine)


class Dice:
    """Policy of random actions within their bounds, for any layout.

    Args:
        max_steps: Largest number of steps that an episode may have.
    """

    name = "dice"

    def __init__(self, max_steps: int) -> None:
        self._max_steps = max_steps

    def describe(self) -> dict[str, Any]:
        """No settings."""
        return {}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Take the episode's stream of random numbers."""
        self._rng, self._low, self._high = rng, layout.low, layout.high
        self._left = self._max_steps

    def act(self, state: np.ndarray) -> np.ndarray:
        """An action drawn uniformly from the action space.

        Raises:
            BrokenClaimError: If the episode goes on for too long.
        """
        demand(self._left, f"an episode goes on after {self._max_steps} steps")
        self._left -= 1
        return self._rng.uniform(self._low, self._high).astype(np.float32)


def demand_inside(actions: np.ndarray, layout: Layout, what: str) -> None:
    """Raise unless float32 actions, shape (..., k), are in the action space.

    Args:
        actions: Actions.
        layout: Layout with their bounds, which a space has as float32, too.
        what: Beginning of the complaint.

    Raises:
        BrokenClaimError: If one of them is outside.
    """
    low, high = (np.array(end, np.float32) for end in (layout.low, layout.high))
    inside = (actions >= low).all() and (actions <= high).all()
    demand(inside, f"{what} outside of the action space")


def episodes(short: ShortTask, numbers: range = range(EPISODES)) -> list[Episode]:
    """Random episodes of a task, by their numbers."""
    dice = Dice(short.task.max_steps)
    with closing(EpisodeCore(short.task)) as core:
        plans = [EpisodePlan(i, episode_seed(0, i, "collect")) for i in numbers]
        return [run_episode(core, dice, plan) for plan in plans]
