"""Policies that studies run in tasks without training any, and their rows."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from marl_mm.collectors.registry import COLLECTORS
from marl_mm.envs.registry import make_task
from marl_mm.eval.evaluate import evaluate
from marl_mm.eval.metrics import Row
from marl_mm.layout import Layout
from marl_mm.policy import Policy
from marl_mm.runs.settings import with_settings
from marl_mm.sim.config import Engine
from marl_mm.versions import engine_text


@dataclass(frozen=True)
class Contestant:
    """A policy of a collector, with noise on its actions."""

    name: str
    """Name in rows and tables."""

    collector: str
    """Registered name of the collector."""

    settings: tuple[tuple[str, Any], ...] = ()
    """Names and values of the collector's settings that are not its defaults."""

    noise: float = 0.0
    """Standard deviation of Gaussian noise on the actions, in their units."""

    def policy(self, task: str, overrides: Mapping[str, Any]) -> Policy:
        """The policy in a task."""
        collector = COLLECTORS.get(self.collector)
        what = f"collector {self.collector}"
        config = with_settings(what, collector.config(), dict(self.settings))
        policy = collector.policy(config, make_task(task, overrides))
        return ActionNoise(policy, self.noise) if self.noise else policy


class ActionNoise:
    """A policy with Gaussian noise on its actions, clipped to their ranges.

    Args:
        policy: Policy that acts.
        noise: Standard deviation of the noise, in the actions' units.
    """

    def __init__(self, policy: Policy, noise: float) -> None:
        self._policy, self._noise = policy, noise
        self.name = f"{policy.name}, noise {noise:g}"

    def describe(self) -> dict[str, Any]:
        """The noise, and the policy's own settings."""
        return {**self._policy.describe(), "noise": self._noise}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Take the episode's stream of random numbers."""
        self._rng, self._low, self._high = rng, layout.low, layout.high
        self._policy.begin(rng, layout)

    def act(self, state: np.ndarray) -> np.ndarray:
        """The policy's action plus noise."""
        action = self._policy.act(state)
        noisy = action + self._rng.normal(0.0, self._noise, len(action))
        return np.clip(noisy, self._low, self._high).astype(np.float32)


@dataclass(frozen=True)
class PolicyCell:
    """A policy in a task on an engine: everything its rows depend on."""

    task: str
    """Registered name of the task."""

    engine: Engine
    """Engine of the simulation."""

    contestant: Contestant
    """Policy."""

    goals: int
    """Number of goals, half ahead and half behind where the task draws none."""

    max_steps: int | None = None
    """Steps of an episode; default the task's."""

    weights: str = ""
    """Fingerprint of the weights of a learnt agent."""

    @property
    def overrides(self) -> dict[str, Any]:
        """Settings of the task that are replaced."""
        steps = {} if self.max_steps is None else {"max_steps": self.max_steps}
        return {**steps, "simulation": {"engine": self.engine}}

    @property
    def label(self) -> str:
        """Label in the progress bar."""
        return f"{self.task} {self.engine} {self.contestant.name}"


_MEASURED = ("steps", "return", "d_mm", "d_mp", "base_jerk_rms")


def run_cell(cell: PolicyCell) -> list[Row]:
    """A row per goal."""
    policy = cell.contestant.policy(cell.task, cell.overrides)
    evaluation = evaluate(policy, cell.goals, 0, cell.task, cell.overrides)
    return [
        {
            "policy": cell.contestant.name,
            "engine": engine_text(cell.engine),
            "seed": 0,
            "goal": row["index"],
            "success": int(row["success"]),
            **{key: row.get(key, np.nan) for key in _MEASURED},
        }
        for row in evaluation.rows
    ]
