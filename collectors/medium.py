"""The medium collector: random at first, then a learnt agent that has to recover."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from marl_mm.collectors.pretrained import load_agent
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.collectors.registry import COLLECTORS, Collector
from marl_mm.envs.task import Task
from marl_mm.errors import UsageError
from marl_mm.layout import Layout


@dataclass(frozen=True)
class MediumConfig:
    """Settings of the medium collector (paper, Sec. 5.4.2)."""

    random_steps: int = 10
    """Number of random steps at the start of each episode; the agent has the rest."""

    agent: str = "pretrained"
    """Agent that acts: "pretrained", which ships, a run folder or a checkpoint file."""

    def __post_init__(self) -> None:
        if self.random_steps < 0:
            raise UsageError(f"random_steps is {self.random_steps}, expected >= 0")


class MediumPolicy:
    """Policy of random actions at first, then of an agent.

    Raises:
        UsageError: If there is no such agent.
        CheckpointError: If its files are damaged.
    """

    name = "medium"

    def __init__(self, config: MediumConfig) -> None:
        self.config = config
        self._random = RandomPolicy(RandomConfig())
        self._agent = load_agent(config.agent)

    def describe(self) -> dict[str, Any]:
        """The config, and the fingerprint of the agent's weights."""
        return asdict(self.config) | {"weights": self._agent.fingerprint}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Take the episode's stream of random numbers; start to count steps."""
        self._steps = 0
        self._random.begin(rng, layout)
        self._agent.begin(rng, layout)

    def act(self, state: np.ndarray) -> np.ndarray:
        """An action drawn uniformly at first, then the agent's."""
        self._steps += 1
        early = self._steps <= self.config.random_steps
        return (self._random if early else self._agent).act(state)


def _medium(config: MediumConfig, task: Task) -> MediumPolicy:
    if config.random_steps >= task.max_steps:
        raise UsageError(
            f"`random_steps` is {config.random_steps}, expected fewer than an "
            f"episode's {task.max_steps}: the agent has the rest"
        )
    return MediumPolicy(config)


COLLECTORS.add(
    "medium",
    Collector(
        about="Act at random first, then as a learnt agent; keep all episodes.",
        config=MediumConfig,
        policy=_medium,
    ),
)
