"""Replay of whole episodes, with goals exchanged in hindsight (Andrychowicz 2017).

The goal of a transition drawn for relabelling becomes what was achieved at the end of
that step or of a later one of its episode (strategy ``future``), and reward and
termination are computed anew.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch

from marl_mm.episode import FAILED, Episode, reward_terms
from marl_mm.errors import UsageError
from marl_mm.layout import Columns, Layout

DRAWN_TOGETHER = 40
"""Batches drawn at once: relabelling costs hardly more for many."""


class Judge(Protocol):
    """Rewards of a task for any goal."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of the costs in the rewards beside the goal; see ``Task.needs``."""

    @property
    def highest_return(self) -> float | None:
        """Bound of all returns; None if none is known."""

    def judge(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Reward and termination of steps by these goals, shapes (n, g) to (n,)."""


def highest_target(judge: Judge, clip: bool) -> float:
    """Bound of critics' targets: the task's highest return, or infinite.

    Args:
        judge: The task.
        clip: Whether to bound targets; no return is higher than that of a perfect hit
            (Andrychowicz 2017, appendix A).
    """
    highest = judge.highest_return if clip else None
    return math.inf if highest is None else highest


def normalized_actions(actions: np.ndarray, layout: Layout) -> np.ndarray:
    """Joint actions in [-1, 1], float32, shape (n, k)."""
    low, high = np.array(layout.low), np.array(layout.high)
    scaled: np.ndarray = (2 * (actions - low) / (high - low) - 1).astype(np.float32)
    return scaled


class Batch(NamedTuple):
    """Transitions, float32; actions in normalised coordinates."""

    observation: torch.Tensor
    """Joint states, shape (n, d)."""

    action: torch.Tensor
    """Joint actions in [-1, 1], shape (n, k)."""

    reward: torch.Tensor
    """Rewards, shape (n,)."""

    next_observation: torch.Tensor
    """Joint states after the steps, shape (n, d)."""

    terminated: torch.Tensor
    """1 where the step reached its goal or failed, 0 elsewhere, also where steps ran
    out, shape (n,)."""

    def split(self, size: int) -> list["Batch"]:
        """Batches of ``size`` transitions each."""
        parts = zip(*(torch.split(column, size) for column in self), strict=True)
        return [Batch(*part) for part in parts]

    def take(self, order: np.ndarray) -> "Batch":
        """The transitions of these numbers."""
        index = torch.from_numpy(order)
        return Batch(*(column[index] for column in self))


def concatenated(batches: Sequence[Batch]) -> Batch:
    """Batches one after the other."""
    if len(batches) == 1:
        return batches[0]
    return Batch(*(torch.cat(columns) for columns in zip(*batches, strict=True)))


class Replay:
    """The latest episodes, at most ``capacity`` steps of them.

    Args:
        capacity: Number of steps that it holds.
        hindsight: Relabelled transitions per original one, the paper's k.
        judge: The task's reward and termination.
        layout: Layout of states and actions.
    """

    def __init__(
        self, capacity: int, hindsight: int, judge: Judge, layout: Layout
    ) -> None:
        self._capacity, self._layout = capacity, layout
        self._share = hindsight / (hindsight + 1)
        self._judge = judge
        # Rings: step s, counted from the first ever, is in row s % capacity.
        # float64, so that a reward computed again is the step's own to the bit.
        self._state = np.zeros((capacity, len(layout.state)))
        self._next_state = np.zeros((capacity, len(layout.state)))
        self._action = np.zeros((capacity, len(layout.action)), np.float32)
        self._reward = np.zeros(capacity)
        self._terminated = np.zeros(capacity, bool)
        self._terms = {name: np.zeros(capacity) for name in (*judge.needs, FAILED)}
        self._end = np.zeros(capacity, np.int64)
        """Number of the last step of each step's episode."""

        self._oldest = self._total = 0

    def __len__(self) -> int:
        return self._total - self._oldest

    def add(self, episode: Episode) -> None:
        """Add an episode, in place of the oldest ones if there is no room.

        Raises:
            UsageError: If the episode alone is longer than the capacity.
        """
        count = len(episode)
        if count > self._capacity:
            raise UsageError(
                f"an episode has {count} steps, but the replay's capacity is "
                f"{self._capacity}: raise it"
            )
        while len(self) + count > self._capacity:
            self._oldest = int(self._end[self._oldest % self._capacity]) + 1
        rows = np.arange(self._total, self._total + count) % self._capacity
        self._state[rows] = episode.states[:-1]
        self._next_state[rows] = episode.states[1:]
        self._action[rows] = normalized_actions(episode.actions, self._layout)
        self._reward[rows] = episode.rewards
        self._terminated[rows] = episode.terminated
        terms = reward_terms(
            self._judge.needs,
            episode.info,
            episode.failed,
            episode.states[1:],
            self._layout,
        )
        for name, values in self._terms.items():
            values[rows] = terms[name]
        self._end[rows] = self._total + count - 1
        self._total += count

    def sample(self, size: int, rng: np.random.Generator) -> Batch:
        """Transitions drawn uniformly, a share of them relabelled."""
        steps = rng.integers(self._oldest, self._total, size)
        relabelled = rng.random(size) < self._share
        later = rng.random(size)
        rows = steps % self._capacity
        state, next_state = self._state[rows], self._next_state[rows]
        reward, terminated = self._reward[rows], self._terminated[rows]

        chosen = np.flatnonzero(relabelled)
        step, end = steps[chosen], self._end[rows[chosen]]
        future = step + (later[chosen] * (end + 1 - step)).astype(np.int64)
        layout = self._layout
        goal = self._next_state[future % self._capacity][:, layout.achieved]
        _put(state, chosen, layout.goal, goal)
        _put(next_state, chosen, layout.goal, goal)
        terms = {name: values[rows[chosen]] for name, values in self._terms.items()}
        reward[chosen], terminated[chosen] = self._judge.judge(
            next_state[chosen][:, layout.achieved], goal, terms
        )
        return Batch(
            torch.from_numpy(state.astype(np.float32)),
            torch.from_numpy(self._action[rows]),
            torch.from_numpy(reward.astype(np.float32)),
            torch.from_numpy(next_state.astype(np.float32)),
            torch.from_numpy(terminated.astype(np.float32)),
        )

    def state(self) -> dict[str, Any]:
        """Contents for a checkpoint."""
        rows = np.arange(self._oldest, self._total) % self._capacity
        contents = {name: torch.from_numpy(a[rows]) for name, a in self._arrays()}
        return {"oldest": self._oldest, "total": self._total, **contents}

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a ``state``."""
        self._oldest, self._total = state["oldest"], state["total"]
        rows = np.arange(self._oldest, self._total) % self._capacity
        for name, array in self._arrays():
            array[rows] = state[name].numpy()

    def _arrays(self) -> list[tuple[str, np.ndarray]]:
        own: dict[str, np.ndarray] = {
            "state": self._state,
            "next_state": self._next_state,
            "action": self._action,
            "reward": self._reward,
            "terminated": self._terminated,
            "end": self._end,
        }
        terms = self._terms.items()
        return [
            *own.items(),
            *((f"term/{n}" if n in own else n, array) for n, array in terms),
        ]


def _put(
    states: np.ndarray, rows: np.ndarray, goal: Columns, values: np.ndarray
) -> None:
    """Write goals into some rows, whether they are a slice of columns or a list."""
    part = states[rows]
    part[:, goal] = values
    states[rows] = part
