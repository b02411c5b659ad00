"""AWAC (Nair 2020, arXiv 2006.09359): imitates most what the critics value most.

Loss of the twin critics: (Q_j(s, a) - r - gamma (1 - terminated) min_j Q_j'(s', a'))^2,
where a' = pi(s'); of the actor: exp(A / lambda) MSE(a, pi(s)), where A is what the
action is worth above the actor's own, min_j Q_j(s, a) - min_j Q_j(s, pi(s)).
"""

from dataclasses import dataclass
from typing import ClassVar

import torch

from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.offline_config import CriticConfig
from marl_mm.algorithms.offline_critics import CriticLearner
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, Algorithm


@dataclass(frozen=True, kw_only=True)
class AwacConfig(CriticConfig):
    """Hyper-parameters, untuned."""

    temperature: float = 1.0
    """Advantage that makes a step weigh e times as much, lambda."""

    largest_weight: float = 100.0
    """Largest weight of a step in the actor's loss."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, ("temperature", "largest_weight"))


class Awac(CriticLearner):
    """One actor that sees and sets everything, and twin critics."""

    name: ClassVar[str] = "awac"
    config: AwacConfig

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; losses of each seed, shape (S,)."""
        config, batch = self.config, self._batches.next()
        self.step += 1
        state, action = self.normalizer(batch.observation), batch.action
        next_state = self.normalizer(batch.next_observation)

        with torch.no_grad():
            next_action = self.actors.joint(next_state)
            value = self._target_critics.least(next_state, next_action)
            target = self._target(batch, value)
        losses = self._learn_critics(state, batch, target)

        with torch.no_grad():
            now = self.actors.joint(state)
            taken, own = (self.critics.least(state, a)[:, 0] for a in (action, now))
            weight = ((taken - own) / config.temperature).exp()
            weight = weight.clamp_max_(config.largest_weight) * batch.imitated
        losses |= self._imitate(state, action, weight)

        self._target_critics.follow(self.critics, config.target_rate)
        return {f"loss/{name}": loss.detach() for name, loss in losses.items()}


ALGORITHMS.add(
    "awac",
    Algorithm(
        title="AWAC",
        loss="exp(A / lambda) MSE(a, pi(s)), A = Q(s, a) - Q(s, pi(s))",
        about="AWAC: cloning weighted by advantage, with critics of its own actions.",
        source="Nair 2020",
        learner=Awac,
        presets={TUNED: AwacConfig()},
    ),
)
