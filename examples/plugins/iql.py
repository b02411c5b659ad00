"""IQL, implicit Q-learning (Kostrikov 2022): never asks a critic for unseen actions.

Loss of V: L_tau(min_j Q_j'(s, a) - V(s)), where L_tau(x) = |tau - 1(x < 0)| x^2; of the
twin critics: (Q_j(s, a) - r - gamma (1 - terminated) V(s'))^2; of the actor:
exp(beta (min_j Q_j'(s, a) - V(s))) MSE(a, pi(s)).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch

from marl_mm.algorithms.config_checks import Precision, check_ranges
from marl_mm.algorithms.diagnostics import DIAGNOSED, imitation_errors
from marl_mm.algorithms.offline_learner import OfflineLearner
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, Algorithm
from marl_mm.algorithms.replay import Judge
from marl_mm.algorithms.seeded import SeededCritics
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import JOINT_NAME


@dataclass(frozen=True)
class IqlConfig:
    """Hyper-parameters: the source's where it names them, untuned."""

    updates: int = 8_000
    """Number of gradient steps."""

    batch_size: int = 256
    """Number of transitions per update."""

    learning_rate: float = 3e-4
    """Learning rate of Adam."""

    discount: float = 0.95
    """Discount of rewards per step, gamma."""

    target_rate: float = 0.005
    """Rate of the target critics per update, tau."""

    expectile: float = 0.7
    """Expectile of V's loss, tau."""

    temperature: float = 3.0
    """Weight of the advantage in the actor's loss, beta."""

    hidden: tuple[int, ...] = (128, 128)
    """Numbers of units of the hidden layers."""

    std_floor: float = 0.01
    """Least standard deviation that observations are scaled by."""

    precision: Precision = "auto"
    """Precision of products of float32 matrices."""

    def __post_init__(self) -> None:
        positive = ("updates", "batch_size", "learning_rate", "target_rate")
        check_ranges(self, positive, ("temperature",), ("discount", "expectile"))


class Iql(OfflineLearner):
    """One actor, values and twin critics; see ``OfflineLearner``."""

    name: ClassVar[str] = "iql"
    config: IqlConfig

    def __init__(
        self,
        config: IqlConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        shares = 0.0, 0.0  # goals stay as they are
        rest = config.learning_rate, seeds, device
        super().__init__(config, arrays, judge, seeds, device, rest[0], shares)
        width = len(self.layout.state)
        self.values = SeededCritics(width, 1, config.hidden, False, *rest)
        width += len(self.layout.action)
        self.critics = SeededCritics(width, 1, config.hidden, False, *rest)
        self._targets = self.critics.copy()
        self._parts = {
            "actors": self.actors,
            "values": self.values,
            "critics": self.critics,
            "targets": self._targets,
        }

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; losses of each seed, shape (S,)."""
        config, batch = self.config, self._batches.next()
        self.step += 1
        state, action = self.normalizer(batch.observation), batch.action
        next_state, nothing = self.normalizer(batch.next_observation), action[..., :0]
        with torch.no_grad():
            taken = self._targets.least(state, action)[:, 0]

        advantage = taken - self.values.first(state, nothing)
        weight = (config.expectile - (advantage < 0).float()).abs()
        value_loss = (weight * advantage.square()).mean(dim=1)
        self.values.descend(value_loss)

        with torch.no_grad():
            alive = config.discount * (1 - batch.terminated)
            target = batch.reward + alive * self.values.first(next_state, nothing)
        errors = self.critics.values(state, action) - target[:, None, None]
        critic_loss = errors.square().mean(dim=3).sum(dim=(1, 2))
        self.critics.descend(critic_loss)

        weight = (config.temperature * advantage.detach()).exp()
        weight.clamp_max_(100.0)  # as in the source's code
        error = (self.actors.joint(state) - action).square().mean(dim=2)
        actor_loss = (weight * error).mean(dim=1)
        self.actors.descend(JOINT_NAME, actor_loss)

        self._targets.follow(self.critics, config.target_rate)
        losses = {"critic": critic_loss, "value": value_loss, "actor": actor_loss}
        return {f"loss/{name}": loss.detach() for name, loss in losses.items()}

    @torch.no_grad()
    def diagnose(self) -> dict[str, torch.Tensor]:
        """Distances of the actor to some of the data's actions, shape (S,)."""
        state, action = self._batches.some(DIAGNOSED)
        inputs = self.normalizer(state).expand(len(self.seeds), -1, -1)
        return imitation_errors(self.actors.joint(inputs), action, self.layout)


_about = "IQL: in-sample values, advantage-weighted cloning."
_parts = {"learner": Iql, "presets": {TUNED: IqlConfig()}, "source": "Kostrikov 2022"}
ALGORITHMS.add("iql", Algorithm(about=_about, **_parts))
