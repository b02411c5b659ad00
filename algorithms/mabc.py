"""MABC, multi-agent behaviour cloning (paper, Sec. 4.4, Algorithm 2).

Two decentralised actors, each on its own observation, no critic:
loss_i = MSE(a_i, pi_i(o_i)).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch.nn import functional

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.networks import Actor, Normalizer
from marl_mm.datasets.dataset import Transitions
from marl_mm.layout import AGENTS

# --- Config ------------------------------------------------------------------


@dataclass(frozen=True)
class MabcConfig:
    """Hyper-parameters; the paper's where it names them (Table 3)."""

    updates: int = 8_000
    """Gradient steps per actor. On 1,500 PD steps, 3,000 gave 85-89 % success over
    three seeds and 200 goals, 6,000 gave 98-100 %; the paper has 100,000 (Table 3)."""

    batch_size: int = 256
    """Transitions per step (Table 3)."""

    learning_rate: float = 5e-4
    """Of Adam (Table 3)."""

    hidden: tuple[int, ...] = (128, 128)
    """Units of each actor's hidden layers; the paper is silent."""

    std_floor: float = 0.01
    """Least standard deviation an observation is scaled by."""

    def __post_init__(self) -> None:
        positive = ("updates", "batch_size", "learning_rate", "std_floor")
        check_ranges(self, positive)


class Mabc:
    """Trains one actor per agent by supervised learning.

    Args:
        config: Hyper-parameters.
        data: Each agent's transitions, by name.
        seed: Of initial weights and batches.
    """

    name = "mabc"

    def __init__(
        self, config: MabcConfig, data: Mapping[str, Transitions], seed: int
    ) -> None:
        self.config = config
        self.step = 0
        self._rng = torch.Generator().manual_seed(seed)
        self._data = {name: _AgentData(part) for name, part in data.items()}
        # --- Networks --------------------------------------------------------
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.agents = {
                agent.name: AgentActor(
                    agent,
                    Actor(
                        Normalizer.of(
                            self._data[agent.name].observation, config.std_floor
                        ),
                        len(agent.action),
                        config.hidden,
                    ),
                )
                for agent in AGENTS
            }
        self._optimizers = {
            name: torch.optim.Adam(agent.actor.parameters(), lr=config.learning_rate)
            for name, agent in self.agents.items()
        }

    # --- Update --------------------------------------------------------------

    def update(self) -> dict[str, float]:
        """One gradient step of every actor on a shared batch."""
        self.step += 1
        size = len(next(iter(self._data.values())).observation)
        index = torch.randint(size, (self.config.batch_size,), generator=self._rng)
        metrics = {}
        for name, agent in self.agents.items():
            observation = self._data[name].observation[index]
            action = agent.scale.normalize(self._data[name].action[index])

            loss = functional.mse_loss(agent.actor(observation), action)

            self._optimizers[name].zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self._optimizers[name].step()
            metrics[f"loss/{name}"] = loss.item()
        return metrics

    # --- State ---------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """Everything that a checkpoint needs to act and to resume bit-equally."""
        return {
            "step": self.step,
            "actors": {n: a.actor.state_dict() for n, a in self.agents.items()},
            "optimizers": {n: o.state_dict() for n, o in self._optimizers.items()},
            "rng": self._rng.get_state(),
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Continue from another run's ``state``."""
        self.step = state["step"]
        for name, agent in self.agents.items():
            agent.actor.load_state_dict(state["actors"][name])
            self._optimizers[name].load_state_dict(state["optimizers"][name])
        self._rng.set_state(state["rng"])


class _AgentData:
    """An agent's observations and actions as tensors."""

    def __init__(self, part: Transitions) -> None:
        self.observation = torch.as_tensor(part.observation, dtype=torch.float32)
        self.action = torch.as_tensor(part.action, dtype=torch.float32)
