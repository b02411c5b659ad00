"""Evaluate a policy on a fixed goal set."""

import json
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import numpy as np

from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.envs.task import Task
from marl_mm.errors import UsageError
from marl_mm.eval.goals import goal_set
from marl_mm.eval.intervals import paired_interval
from marl_mm.eval.metrics import EvaluationRow, episode_row, summarize_directions
from marl_mm.notebook import html_table
from marl_mm.policy import Policy
from marl_mm.progress import Advance, silent
from marl_mm.sim.config import ENGINES, engine_of, to_record
from marl_mm.versions import versions


@dataclass(frozen=True)
class Evaluation:
    """Episodes of a policy on fixed goals, and their summary."""

    policy: str
    """Name of the policy."""

    policy_config: dict[str, Any]
    """Settings of the policy."""

    task: str
    """Registered name of the task."""

    overrides: dict[str, Any]
    """Replaced fields of the task."""

    seed: int
    """Seed of goals, environment and policy."""

    rows: list[EvaluationRow]
    """Rows, one per episode; see ``episode_row``."""

    engine_version: str = ""
    """Version of the engine's package; empty in records without it."""

    @property
    def engine(self) -> str:
        """Engine with its version, such as "mujoco 4.0.0"."""
        return f"{engine_of(self.overrides)} {self.engine_version}".strip()

    @property
    def summary(self) -> dict[str, dict[str, Any]]:
        """Summaries by direction: ``all``, ``forward``, ``backward``."""
        return summarize_directions(self.rows)

    @property
    def success_rate(self) -> float:
        """Share of goals reached."""
        return float(self.summary["all"]["success_rate"])

    def less(self, other: "Evaluation") -> tuple[float, tuple[float, float]]:
        """Success rate less another's on the same goals, and its paired interval.

        The interval is of 95 %, see ``paired_interval``.

        Raises:
            UsageError: If the other is no evaluation, or of other goals.
        """
        if not isinstance(other, Evaluation):
            raise UsageError(f"{other!r:.60} is no Evaluation, expected another one")
        goals = [
            (e.task, [(row["seed"], row.get("goal")) for row in e.rows])
            for e in (self, other)
        ]
        if goals[0] != goals[1]:
            raise UsageError(
                f"{self!r} and {other!r} are not on the same goals: evaluate both on "
                "one task with the same `episodes` and `seed`"
            )
        own, others = ([row["success"] for row in e.rows] for e in (self, other))
        return self.success_rate - other.success_rate, paired_interval(own, others)

    def __repr__(self) -> str:
        reached = sum(row["success"] for row in self.rows)
        goals = f"{reached} of {len(self.rows)} goals"
        return f"<Evaluation: {self.policy} reached {goals} of {self.task}>"

    def _repr_html_(self) -> str:
        """The table with intervals, for notebooks."""
        from marl_mm.eval.tables import header, table_rows  # which needs evaluations

        about = escape(f"{self.task}, engine: {self.engine}")
        return f"{html_table(table_rows([self]), header())}<p>{about}</p>"

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "Evaluation":
        """The evaluation of a dictionary of ``to_json``."""
        names = ("policy", "policy_config", "task", "overrides", "seed", "episodes")
        version = str(values.get("engine_version", ""))
        evaluation = cls(*(values[name] for name in names))
        return replace(evaluation, engine_version=version)

    def to_json(self) -> dict[str, Any]:
        """The evaluation as JSON-serialisable values, the layout of ``eval.json``."""
        everything = self.summary["all"]
        return {
            "policy": self.policy,
            "policy_config": self.policy_config,
            "task": self.task,
            "overrides": self.overrides,
            "engine": engine_of(self.overrides),
            "engine_version": self.engine_version,
            "seed": self.seed,
            "success_rate": everything["success_rate"],
            "interval": everything["interval"],
            "summary": self.summary,
            "episodes": self.rows,
        }


def evaluate(
    policy: Policy,
    episodes: int = 100,
    seed: int = 0,
    task: str = "Reach-v0",
    overrides: Mapping[str, Any] | None = None,
    workers: int = 1,
    advance: Advance = silent,
) -> Evaluation:
    """Run a policy on a seed's goals; see ``goal_set``.

    Args:
        policy: Policy to evaluate.
        episodes: Number of goals.
        seed: Seed of goals, environment and policy.
        task: Registered name of the task.
        overrides: Replaced fields of the task.
        workers: Number of processes; the result does not depend on it.
        advance: Called with the number of finished episodes.

    Raises:
        UsageError: If ``episodes`` is not positive or ``seed`` is negative.
    """
    with Rollouts(make_task(task, overrides), workers) as rollouts:
        return evaluate_with(rollouts, policy, episodes, seed, task, overrides, advance)


def evaluate_with(
    rollouts: Rollouts,
    policy: Policy,
    episodes: int,
    seed: int,
    task: str,
    overrides: Mapping[str, Any] | None = None,
    advance: Advance = silent,
    states: list[np.ndarray] | None = None,
) -> Evaluation:
    """``evaluate`` in existing environments of the task.

    The joint states of each episode are added to ``states``.
    """
    if episodes < 1:
        raise UsageError(f"episodes is {episodes}, expected >= 1")
    if seed < 0:
        raise UsageError(f"seed is {seed}, expected >= 0")
    described = _described(policy)
    rows: list[EvaluationRow] = []
    reached = 0
    plans = goal_set(make_task(task, overrides), episodes, seed)
    for episode in rollouts.run(policy, plans):
        if states is not None:
            states.append(episode.states)
        rows.append(episode_row(episode))
        reached += rows[-1]["success"]
        advance(1, f"{reached}/{len(rows)} reached")
    replaced = to_record(overrides or {})
    package, _ = ENGINES[engine_of(replaced)]
    version = versions()[package]
    return Evaluation(policy.name, described, task, replaced, seed, rows, version)


def _described(policy: Policy) -> dict[str, Any]:
    """Settings of a policy, as JSON has them."""
    try:
        text = json.dumps(policy.describe(), default=_plain, allow_nan=False)
        values: dict[str, Any] = json.loads(text)
    except (TypeError, ValueError) as error:
        raise UsageError(
            f"policy {policy.name} describes itself by {policy.describe()!r:.80}, "
            f"expected finite numbers, text and lists of them ({error})"
        ) from None
    return values


def _plain(value: Any) -> Any:
    """NumPy's numbers and arrays as Python's."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is none of them")


@dataclass(frozen=True)
class Setup:
    """Task and goals of evaluations that are compared."""

    task: str
    """Registered name of the task."""

    overrides: Mapping[str, Any]
    """Replaced fields of the task."""

    episodes: int
    """Number of goals."""

    seed: int
    """Seed of goals, environment and policies."""

    workers: int = 1
    """Number of processes; results do not depend on it."""

    @property
    def made(self) -> Task:
        """The task."""
        return make_task(self.task, self.overrides)

    def rollouts(self) -> Rollouts:
        """New environments of the task."""
        return Rollouts(self.made, self.workers)

    def run(
        self,
        rollouts: Rollouts,
        policy: Policy,
        advance: Advance = silent,
        states: list[np.ndarray] | None = None,
    ) -> Evaluation:
        """``evaluate_with`` on these goals."""
        goals = self.episodes, self.seed, self.task, self.overrides
        return evaluate_with(rollouts, policy, *goals, advance, states)


def check_task(task: Task) -> None:
    """Raise a UsageError where its engine is not installed, or lacks the task."""
    with closing(EpisodeCore(task)) as core:
        core.reset(np.random.default_rng(0))
