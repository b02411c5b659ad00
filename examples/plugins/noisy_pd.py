"""A collector: the PD agent with noise that drifts (Ornstein-Uhlenbeck)."""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.collectors.registry import COLLECTORS, Collector
from marl_mm.errors import UsageError
from marl_mm.layout import Layout


@dataclass(frozen=True)
class NoisyPdConfig:
    """Settings of the noisy PD collector."""

    noise: float = 0.3
    """Standard deviation of the drift, as a share of half of each action's range."""

    memory: float = 0.7
    """Share of the drift that remains after a step, 0 to below 1."""

    pd: PdConfig = field(default_factory=lambda: PdConfig(alpha_rule="room"))
    """Settings of the PD agent."""

    def __post_init__(self) -> None:
        if not (0.0 <= self.noise <= 10.0 and 0.0 <= self.memory < 1.0):
            raise UsageError(
                f"noise is {self.noise} and memory {self.memory}, expected [0, 10] and "
                "[0, 1)"
            )


class NoisyPd:
    """Policy of the PD agent with a drift."""

    name = "noisy-pd"

    def __init__(self, config: NoisyPdConfig) -> None:
        self.config, self._pd = config, PdPolicy(config.pd)

    def describe(self) -> dict[str, Any]:
        """The config."""
        return asdict(self.config)

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Take the episode's stream of random numbers, and start without drift."""
        self._pd.begin(rng, layout)
        self._rng, self._low, self._high = rng, layout.low, layout.high
        self._drift = np.zeros(len(layout.action))

    def act(self, state: np.ndarray) -> np.ndarray:
        """The PD action plus the drift, clipped to the action space."""
        memory = self.config.memory
        fresh = self._rng.normal(0.0, self.config.noise, len(self._drift))
        self._drift = memory * self._drift + np.sqrt(1 - memory**2) * fresh
        half = np.subtract(self._high, self._low) / 2
        action = self._pd.act(state) + half * self._drift
        return np.clip(action, self._low, self._high).astype(np.float32)


COLLECTORS.add(
    "noisy-pd",
    Collector(
        about="Steer to the goal and drift off; keep all episodes.",
        config=NoisyPdConfig,
        policy=lambda config, task: NoisyPd(config),
    ),
)
