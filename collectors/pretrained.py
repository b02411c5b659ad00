"""The pretrained collector: a learnt agent, with or without noise ("good" data)."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from marl_mm.collectors.registry import COLLECTORS, Collector, successes
from marl_mm.errors import UsageError
from marl_mm.layout import Layout

if TYPE_CHECKING:
    from marl_mm.algorithms.policy import LearnedPolicy


@dataclass(frozen=True)
class PretrainedConfig:
    """Settings of the pretrained collector."""

    agent: str = "pretrained"
    """Agent that acts: "pretrained", which ships, a run folder or a checkpoint file."""

    noise: float = 0.0
    """Standard deviation of Gaussian noise on the actions, in their units."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.noise <= 10.0:
            raise UsageError(f"noise is {self.noise}, expected a number in [0, 10]")


class PretrainedPolicy:
    """Policy of an agent with noise.

    Raises:
        UsageError: If there is no such agent.
        CheckpointError: If its files are damaged.
    """

    name = "pretrained"

    def __init__(self, config: PretrainedConfig) -> None:
        self.config = config
        self._agent = load_agent(config.agent)

    def describe(self) -> dict[str, Any]:
        """The config, and the fingerprint of the agent's weights."""
        return asdict(self.config) | {"weights": self._agent.fingerprint}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Take the episode's stream of random numbers."""
        self._rng, self._low, self._high = rng, layout.low, layout.high
        self._agent.begin(rng, layout)

    def act(self, state: np.ndarray) -> np.ndarray:
        """The agent's action plus noise, clipped to the action space."""
        action = self._agent.act(state)
        if self.config.noise:
            noisy = action + self._rng.normal(0.0, self.config.noise, len(action))
            action = np.clip(noisy, self._low, self._high)
        return action.astype(np.float32)


def load_agent(name: str) -> "LearnedPolicy":
    """A learnt agent by name or path; see ``load_policy``."""
    from marl_mm.algorithms.policy import load_policy  # torch takes a second to import

    return load_policy(name)


COLLECTORS.add(
    "pretrained",
    Collector(
        about="Let a learnt agent act; keep the episodes that reach the goal "
        '("good" data).',
        config=PretrainedConfig,
        policy=lambda config, task: PretrainedPolicy(config),
        keeps=successes,
        dataset="good",
    ),
)
