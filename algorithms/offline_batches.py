"""Batches of a dataset, drawn many at a time, with goals exchanged in hindsight.

The robot's motion does not depend on the goal. Any goal may replace a step's own, with
reward and termination computed anew: one that its episode reached later (Andrychowicz
2017), or another episode's, which teaches the critic the value of going elsewhere
(Chebotar 2021).
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch

from marl_mm.algorithms.replay import (
    DRAWN_TOGETHER,
    Judge,
    normalized_actions,
)
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.errors import DatasetError, UsageError

_TERM = "term/"
"""Beginning of the names of the numbers that rewards need, among arrays of steps."""


class OfflineBatch(NamedTuple):
    """Transitions of S seeds, float32; actions in normalised coordinates."""

    observation: torch.Tensor
    """Joint states, shape (S, B, d)."""

    action: torch.Tensor
    """Joint actions in [-1, 1], shape (S, B, h k): of a step, or of a chunk of h."""

    reward: torch.Tensor
    """Rewards, of a chunk the discounted sum, shape (S, B)."""

    next_observation: torch.Tensor
    """Joint states after the steps or chunks, shape (S, B, d)."""

    next_action: torch.Tensor
    """Joint actions of the steps after the first ones, of chunks too, shape (S, B, k);
    of an episode's last step, its own."""

    terminated: torch.Tensor
    """1 where the last step reached its goal or failed, 0 elsewhere, also where steps
    ran out, shape (S, B)."""

    discount: torch.Tensor
    """Discount of the value after the step or chunk, shape (S, B)."""

    imitated: torch.Tensor
    """0 where the goal is that of any other step, which the action was not for, shape
    (S, B)."""

    successful: torch.Tensor
    """1 in episodes that reached their goal, shape (S, B)."""

    rest: torch.Tensor
    """Discounted return of the episode from the step on, for its own goal, shape (S,
    B); minus infinity where it was cut off, and would have gone on."""

    within: torch.Tensor
    """1 where a step of the chunk is one of the episode, shape (S, B, h)."""

    noise: torch.Tensor
    """Standard normal noise for the target's actions, shape (S, B, h k)."""

    extra: torch.Tensor
    """More such noise, of flows and of sampled actions, shape (S, B, extra)."""


class OfflineBatches:
    """Draws the batches of S seeds, each from a stream of its own.

    Args:
        arrays: The dataset's episodes.
        size: Transitions per batch.
        shares: Shares of transitions relabelled with a goal that their episode reached
            later, and with the goal of any other step.
        judge: The task's reward and termination.
        seeds: Seeds of the streams, S of them.
        device: Device of the batches.
        extra: Entries of ``OfflineBatch.extra``.
        chunk: Steps in a row that are learnt as one, h. Where the episode ends sooner,
            its last action is repeated.
        discount: Discount of rewards per step.

    Raises:
        DatasetError: If a value of the dataset is not finite.
        UsageError: If goals are to be exchanged, and the dataset does not tell the
            costs that rewards depend on, or chunks have several steps.
    """

    def __init__(
        self,
        arrays: EpisodeArrays,
        size: int,
        shares: tuple[float, float],
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
        extra: int = 0,
        chunk: int = 1,
        discount: float = 1.0,
    ) -> None:
        refuse_odd_values(arrays)
        self._layout, self._extra = arrays.layout, extra
        self._size, self._judge, self._device = size, judge, device
        self._future, self._elsewhere = shares
        self._chunk, self._discount = chunk, discount
        self._steps = _steps(arrays, judge, discount)
        self._given, self._kept = len(self), 1.0
        if any(shares) and chunk > 1:
            raise UsageError(
                f"chunks of {chunk} steps with other goals, expected their own: set "
                "`future` and `elsewhere` to 0"
            )
        self._terms = [name for name in self._steps if name.startswith(_TERM)]
        if any(shares):
            refuse_missing_terms(
                arrays,
                judge.needs,
                "set `future` to 0, and `elsewhere` to 0 where there is one",
            )
        self._streams = [np.random.default_rng(seed) for seed in seeds]
        self._begun = [stream.bit_generator.state for stream in self._streams]
        self._drawn: list[OfflineBatch] = []
        self._taken = 0

    def __len__(self) -> int:
        return len(self._steps["reward"])

    @property
    def own(self) -> tuple[int, int]:
        """Numbers of the learner's own episodes, and of their steps."""
        ends = self._steps["end"][self._given :]
        return len(np.unique(ends)), len(ends)

    @property
    def largest_reward(self) -> float:
        """Largest absolute reward, own steps included."""
        return float(np.abs(self._steps["reward"]).max())

    def add(self, episodes: EpisodeArrays, kept: float) -> None:
        """Add episodes of the learner's own, which the next batches draw from.

        Args:
            episodes: The episodes.
            kept: Share of the transitions drawn that still comes from the dataset.
        """
        added = _steps(episodes, self._judge, self._discount)
        added["end"] = added["end"] + len(self)
        self._kept = kept
        self._append(added)
        self._drawn, self._taken = [], 0
        self._begun = [stream.bit_generator.state for stream in self._streams]

    def _append(self, added: Mapping[str, np.ndarray]) -> None:
        before = self._steps.items()
        self._steps = {name: np.concatenate([a, added[name]]) for name, a in before}

    def next(self) -> OfflineBatch:
        """Next batch of every seed."""
        if self._taken == len(self._drawn):
            self._draw()
        self._taken += 1
        return self._drawn[self._taken - 1]

    def some(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Fixed states and actions of the dataset, shapes (1, n, d) and (1, n, h k)."""
        rows = np.linspace(0, self._given - 1, min(count, self._given))
        rows = rows.astype(np.int64)
        state = torch.from_numpy(self._steps["state"][rows].astype(np.float32))
        action = torch.from_numpy(self._actions(self._ahead(rows)))
        return state[None].to(self._device), action[None].to(self._device)

    def state(self, number: int) -> dict[str, Any]:
        """State of one seed's stream, and of its own episodes."""
        state = {"begun": json.dumps(self._begun[number]), "taken": self._taken}
        if len(self) == self._given:
            return state
        own = {n: torch.from_numpy(a[self._given :]) for n, a in self._steps.items()}
        return {**state, "kept": self._kept, "own": own}

    def load_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Continue all streams from their ``state``."""
        for stream, state in zip(self._streams, states, strict=True):
            stream.bit_generator.state = json.loads(state["begun"])
        if "own" in states[0]:  # of a single seed
            self._kept = states[0]["kept"]
            self._append({n: a.numpy() for n, a in states[0]["own"].items()})
        self._drawn, self._taken = [], 0
        if states[0]["taken"]:
            self._draw()
            self._taken = states[0]["taken"]
        else:
            self._begun = [stream.bit_generator.state for stream in self._streams]

    def _draw(self) -> None:
        self._begun = [stream.bit_generator.state for stream in self._streams]
        parts = [self._sample(stream) for stream in self._streams]
        columns = []
        for arrays in zip(*parts, strict=True):
            shape = (DRAWN_TOGETHER, self._size, *arrays[0].shape[1:])
            stacked = np.stack([array.reshape(shape) for array in arrays], axis=1)
            columns.append(torch.from_numpy(stacked).to(self._device))
        self._drawn = [OfflineBatch(*batch) for batch in zip(*columns, strict=True)]
        self._taken = 0

    def _sample(self, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
        """One seed's transitions of many batches, in the order of ``OfflineBatch``."""
        count, of = DRAWN_TOGETHER * self._size, self._steps
        rows = self._rows(rng, count)
        kind, later = rng.random(count), rng.random(count)
        others = rng.integers(len(self), size=count)
        width = self._chunk * of["action"].shape[1]
        noise = rng.standard_normal((count, width), np.float32)
        extra = rng.standard_normal((count, self._extra), np.float32)
        ahead = self._ahead(rows)
        within = rows[:, None] + np.arange(self._chunk) == ahead
        weights = within * self._discount ** np.arange(self._chunk)
        state, next_state = of["state"][rows], of["next_state"][ahead[:, -1]]
        reward = (weights * of["reward"][ahead]).sum(axis=1)
        terminated = of["terminated"][ahead[:, -1]]
        future = kind < self._future
        elsewhere = ~future & (kind < self._future + self._elsewhere)

        span = (later * (of["end"][rows] - rows)).astype(np.int64)
        places, achieved = self._layout.goal, self._layout.achieved
        goal, later_state = state[:, places], of["next_state"][rows + span]
        goal = np.where(future[:, None], later_state[:, achieved], goal)
        goal = np.where(elsewhere[:, None], of["state"][others][:, places], goal)
        state[:, places], next_state[:, places] = goal, goal
        changed = np.flatnonzero(future | elsewhere)
        terms = {n.removeprefix(_TERM): of[n][rows[changed]] for n in self._terms}
        reward[changed], terminated[changed] = self._judge.judge(
            next_state[changed][:, achieved], goal[changed], terms
        )
        return (
            state.astype(np.float32),
            self._actions(ahead),
            reward.astype(np.float32),
            next_state.astype(np.float32),
            of["action"][np.minimum(rows + 1, of["end"][rows] - 1)],
            terminated.astype(np.float32),
            (self._discount ** within.sum(axis=1)).astype(np.float32),
            (~elsewhere).astype(np.float32),
            of["success"][rows],
            of["rest"][rows],
            within.astype(np.float32),
            noise,
            extra,
        )

    def _rows(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Rows of steps, of the dataset and of the learner's own in a set ratio."""
        if len(self) == self._given:
            return rng.integers(self._given, size=count)
        own = rng.integers(self._given, len(self), size=count)
        given = rng.integers(self._given, size=count)
        return np.where(rng.random(count) < self._kept, given, own)

    def _ahead(self, rows: np.ndarray) -> np.ndarray:
        """Rows of the chunks that begin at ``rows``, shapes (n,) to (n, h).

        Beyond an episode's end they are its last row.
        """
        last = self._steps["end"][rows] - 1
        ahead = rows[:, None] + np.arange(self._chunk)
        steps: np.ndarray = np.minimum(ahead, last[:, None])
        return steps

    def _actions(self, steps: np.ndarray) -> np.ndarray:
        """Actions of chunks, shapes (n, h) to (n, h k)."""
        actions: np.ndarray = self._steps["action"][steps].reshape(len(steps), -1)
        return actions


def _steps(
    arrays: EpisodeArrays, judge: Judge, discount: float
) -> dict[str, np.ndarray]:
    """Arrays of steps by name, shape (n, ...), with the numbers that rewards need."""
    ends, terms = np.cumsum(arrays.lengths), arrays.reward_terms(judge.needs)
    return {
        **{f"{_TERM}{name}": values for name, values in terms.items()},
        # float64, so that a reward computed again is the step's own to the bit.
        "state": arrays.states[~arrays.is_last_state()],
        "next_state": arrays.states[~arrays.is_first_state()],
        "action": normalized_actions(arrays.actions, arrays.layout),
        "reward": arrays.rewards,
        "terminated": arrays.terminated,
        "success": np.repeat(arrays.successes(), arrays.lengths).astype(np.float32),
        "rest": _rest(arrays, discount),
        "end": np.repeat(ends, arrays.lengths),  # row after the episode's last
    }


def _rest(arrays: EpisodeArrays, discount: float) -> np.ndarray:
    """Discounted return from each step to its episode's end, shape (n,), float32.

    Minus infinity in episodes that were cut off, whose rest is not known.
    """
    last = np.cumsum(arrays.lengths) - 1
    rest = arrays.rewards.copy()
    for back in range(1, int(arrays.lengths.max())):
        rows = last[arrays.lengths > back] - back
        rest[rows] += discount * rest[rows + 1]
    rest[np.repeat(arrays.truncated[last], arrays.lengths)] = -np.inf
    return rest.astype(np.float32)


def refuse_missing_terms(
    arrays: EpisodeArrays, needs: Sequence[str], way_out: str
) -> None:
    """Raise a UsageError if steps lack a number that rewards for any goal depend on."""
    terms = arrays.reward_terms(needs).values()
    if not all(np.isfinite(values).all() for values in terms):
        raise UsageError(
            f"the dataset lacks {', '.join(needs)} of some steps, which rewards for "
            f"other goals depend on: {way_out}"
        )


def refuse_odd_values(arrays: EpisodeArrays) -> None:
    """Raise a DatasetError for the first value that is not finite."""
    for name in ("states", "actions", "rewards"):
        finite = np.isfinite(getattr(arrays, name))
        if not finite.all():
            raise DatasetError(
                f"{np.sum(~finite)} values of the dataset's {name} are not finite, the "
                f"first in row {np.argwhere(~finite)[0][0]}: marl-mm datasets verify "
                "tells more"
            )
