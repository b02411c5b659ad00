"""TD3+BC (paper, Algorithm 2; Fujimoto & Gu 2021): one actor that sees and sets all.

Loss of the twin critics: (Q_j(s, a) - r - gamma (1 - terminated) min_j Q_j'(s', a'))^2,
where a' is the target actor's action with clipped noise. Every second update the actor
follows: -lambda Q_1(s, pi(s)) + MSE(a, pi(s)), where lambda = c / mean |Q_1(s, pi(s))|.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.config_checks import check_ranges
from marl_mm.algorithms.networks import DIAGNOSED, Normalizer
from marl_mm.algorithms.offline_batches import OfflineBatch, OfflineBatches
from marl_mm.algorithms.registry import ALGORITHMS, PAPER, TUNED, Algorithm
from marl_mm.algorithms.replay import Judge, normalized_actions
from marl_mm.algorithms.seeded import (
    Parts,
    SeededActors,
    SeededCritics,
    imitation_errors,
    load_parts,
    parts_state,
)
from marl_mm.algorithms.speed import Precision
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.errors import UsageError
from marl_mm.layout import JOINT_NAME, AgentLayout

# --- Config ------------------------------------------------------------------


WEIGHTED = ("delta_x", "delta_y", "delta_z", "alpha")
"""Entries of the action whose imitation can be weighted; others weigh 1."""

LEAST_SPREAD = 0.1
"""Imitation errors are divided by an entry's standard deviation in the data, by this at
least, as a share of half its range."""


@dataclass(frozen=True)
class Td3BcConfig:
    """Hyper-parameters."""

    updates: int = 10_000
    """Gradient steps of the critics; the paper has 100,000 (Table 3) and 180,000
    (Table 4)."""

    batch_size: int = 256
    """Transitions per update (Table 3)."""

    actor_learning_rate: float = 5e-4
    """Of Adam (Table 3)."""

    critic_learning_rate: float = 5e-4
    """Of Adam (Table 3)."""

    discount: float = 0.95
    """gamma (Table 3)."""

    target_rate: float = 0.005
    """tau, the share of the networks that goes into their targets (Table 3)."""

    q_weight: float = 0.5
    """c, the weight of the value against imitation; 2.5 in Fujimoto & Gu 2021."""

    q_weight_end: float | None = None
    """c at the last update, to which it goes in a straight line; default c."""

    policy_delay: int = 2
    """Updates of the critics per update of the actor (Fujimoto 2018)."""

    target_noise: float = 0.2
    """Standard deviation of the noise on the target's action, of half its range."""

    target_noise_clip: float = 0.5
    """Largest such noise, of half the action's range."""

    future: float = 0.2
    """Share of transitions whose goal becomes one that their episode came to later."""

    elsewhere: float = 0.4
    """Share of transitions whose goal becomes that of any other step; they are not
    imitated."""

    clip_targets: bool = True
    """Cut the critics' targets off at the reward of a perfect hit, which no return can
    pass, as all other rewards are negative."""

    layer_norm: bool = True
    """Whether the critics' hidden layers are normalised (Ball 2023)."""

    imitate: Literal["all", "better", "successful"] = "successful"
    """Which actions are imitated: all, those that the critic thinks better than the
    actor's (Nair 2018), or those of episodes that reached their goal."""

    imitation_weights: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    """Weight in the imitation error of delta_x, delta_y, delta_z and alpha; of other
    entries it is 1."""

    imitation_scaled: bool = True
    """Measure the imitation error of each entry by its spread in the data: where the
    data hardly vary, the critic knows no better."""

    hidden: tuple[int, ...] = (128, 128)
    """Units of the hidden layers of actor and critics; the paper is silent."""

    std_floor: float = 0.01
    """Least standard deviation an observation is scaled by."""

    precision: Precision = "auto"
    """Of products of float32 matrices, as torch has it. With medium they are faster on
    many CPUs and GPUs; where these have units for bfloat16, they are rounded to it.
    With auto it is medium where that is as exact, as a trial at the start shows."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            positive=(
                "updates",
                "batch_size",
                "actor_learning_rate",
                "critic_learning_rate",
                "target_rate",
                "policy_delay",
                "std_floor",
            ),
            not_negative=("q_weight", "target_noise", "target_noise_clip"),
            shares=("discount", "target_rate", "future", "elsewhere"),
        )
        if self.q_weight_end is not None:
            check_ranges(self, (), not_negative=("q_weight_end",))
        weights = self.imitation_weights
        if len(weights) != len(WEIGHTED) or not all(0 < w < math.inf for w in weights):
            raise UsageError(
                f"imitation_weights is {weights}, expected one > 0 for each of "
                f"{', '.join(WEIGHTED)}"
            )
        if self.future + self.elsewhere > 1:
            raise UsageError(
                f"future is {self.future} and elsewhere {self.elsewhere}, expected at "
                "most 1 together"
            )


class Td3Bc:
    """Learns from a dataset's transitions, for several seeds at once.

    Args:
        config: Hyper-parameters.
        arrays: The dataset's episodes.
        judge: The task's reward and termination.
        seeds: Of initial weights and batches, S of them.
        device: "cpu" or "cuda".
    """

    name: ClassVar[str] = "td3-bc"

    def __init__(
        self,
        config: Td3BcConfig,
        arrays: EpisodeArrays,
        judge: Judge,
        seeds: Sequence[int],
        device: str = "cpu",
    ) -> None:
        self.config, self.seeds, self.step = config, tuple(seeds), 0
        self.layout = arrays.layout
        self.layouts = self._layouts()
        shares = config.future, config.elsewhere
        self._batches = OfflineBatches(
            arrays, config.batch_size, shares, judge, seeds, device
        )
        self._highest = judge.highest_return if config.clip_targets else None
        self._weights = self._imitation_weights(arrays).to(device)
        largest = float(np.abs(arrays.rewards).max()) / max(1 - config.discount, 1e-3)
        watched = "q/data", "q/policy", "q/largest"
        self.bounds = dict.fromkeys(watched, 100 * largest)
        # --- Networks --------------------------------------------------------
        states = torch.from_numpy(arrays.states).float()
        self.normalizer = Normalizer.of(states, config.std_floor).to(device)
        self.actors = SeededActors(
            self.layouts,
            self.normalizer,
            config.hidden,
            config.actor_learning_rate,
            seeds,
            device,
        )
        self.critics = SeededCritics(
            len(self.layout.state) + len(self.layout.action),
            self._pairs(),
            config.hidden,
            config.layer_norm,
            config.critic_learning_rate,
            seeds,
            device,
        )
        self._target_actors = self.actors.copy()
        self._target_critics = self.critics.copy()

    def _imitation_weights(self, arrays: EpisodeArrays) -> torch.Tensor:
        """Of the squared error of each entry of the action, shape (k,)."""
        own = dict(zip(WEIGHTED, self.config.imitation_weights, strict=True))
        weights = torch.tensor(
            [own.get(name, 1.0) for name in self.layout.action_names]
        )
        weights = weights / weights.mean()
        if self.config.imitation_scaled:
            actions = torch.from_numpy(normalized_actions(arrays.actions, self.layout))
            weights /= actions.var(dim=0, correction=0).clamp_min(LEAST_SPREAD**2)
        return weights

    def _layouts(self) -> tuple[AgentLayout, ...]:
        """Actors that each seed has."""
        return (self.layout.joint,)

    def _pairs(self) -> int:
        """Pairs of critics that each seed has."""
        return 1

    # --- Update --------------------------------------------------------------

    def update(self) -> dict[str, torch.Tensor]:
        """One gradient step; losses of each seed, shape (S,)."""
        config, batch = self.config, self._batches.next()
        self.step += 1
        state = self.normalizer(batch.observation)
        next_state = self.normalizer(batch.next_observation)

        with torch.no_grad():
            noise = batch.noise * config.target_noise
            noise.clamp_(-config.target_noise_clip, config.target_noise_clip)
            next_action = (self._target_actors.joint(next_state) + noise).clamp_(-1, 1)
            value = self._target_critics.least(next_state, next_action)
            alive = config.discount * (1 - batch.terminated)
            target = batch.reward[:, None] + alive[:, None] * value
            if self._highest is not None:
                target.clamp_max_(self._highest)

        errors = self.critics.values(state, batch.action) - target[:, :, None]
        loss = errors.square().mean(dim=3).sum(dim=(1, 2))
        self.critics.descend(loss)
        losses = {"loss/critic": loss.detach()}

        if self.step % config.policy_delay == 0:
            losses |= self._improve(state, batch)
            self._target_actors.follow(self.actors, config.target_rate)
            self._target_critics.follow(self.critics, config.target_rate)
        return losses

    def _improve(
        self, state: torch.Tensor, batch: OfflineBatch
    ) -> dict[str, torch.Tensor]:
        """One gradient step of the actor."""
        action = self.actors.joint(state)
        value = self.critics.first(state, action)
        error = self._imitation(action, state, batch, value)
        loss = error - self._weight(value) * value.mean(dim=1)
        self.actors.descend(JOINT_NAME, loss)
        return {"loss/actor": loss.detach(), "loss/imitation": error.detach()}

    def _imitation(
        self,
        action: torch.Tensor,
        state: torch.Tensor,
        batch: OfflineBatch,
        value: torch.Tensor,
        own: slice | list[int] = slice(None),
        pair: int = 0,
    ) -> torch.Tensor:
        """Weighted mean square of an agent's entries that it is to imitate, shape (S,).

        It is the mean over what is imitated, so that c weighs the same however much of
        a batch that is.
        """
        imitated = batch.imitated
        if self.config.imitate == "successful":
            imitated = imitated * batch.successful
        elif self.config.imitate == "better":
            with torch.no_grad():
                other = action.clone()
                other[..., own] = batch.action[..., own]
                taken = self.critics.first(state, other, pair)
            imitated = imitated * (taken > value.detach())
        squares = (action[..., own] - batch.action[..., own]).square()
        errors = (squares * self._weights[own]).mean(dim=2) * imitated
        return errors.sum(dim=1) / imitated.sum(dim=1).clamp_min(1)

    def _weight(self, value: torch.Tensor) -> torch.Tensor:
        """lambda, of each seed, shape (S,)."""
        c, end = self.config.q_weight, self.config.q_weight_end
        if end is not None:
            c += (end - c) * self.step / self.config.updates
        return c / value.detach().abs().mean(dim=1)

    @torch.no_grad()
    def diagnose(self) -> dict[str, torch.Tensor]:
        """What critics and actors do on some of the data, shape (S,).

        Q is the first critic's, which an actor follows; ``q/largest`` the farthest from
        0 of any. ``q/slope``, where the layout has ``delta_x`` and ``goal_x``: how much
        more it values going to the goal than away from it, along x; below 0 it has
        learnt the opposite.
        """
        state, action = self._batches.some(DIAGNOSED)
        inputs = self.normalizer(state).expand(len(self.seeds), -1, -1)
        action = action.expand(len(self.seeds), -1, -1)
        now = self.actors.joint(inputs)
        return {
            "q/data": self.critics.first(inputs, action).mean(dim=1),
            "q/policy": self.critics.first(inputs, now).mean(dim=1),
            "q/largest": self.critics.values(inputs, now).abs().amax(dim=(1, 2, 3)),
            **self._slope(state, inputs, action),
            **imitation_errors(now, action, self.layout),
        }

    def _slope(
        self, state: torch.Tensor, inputs: torch.Tensor, action: torch.Tensor
    ) -> dict[str, torch.Tensor]:
        layout = self.layout
        if "delta_x" not in layout.action_names or "goal_x" not in layout.desired:
            return {}
        here = layout.compared[layout.desired.index("goal_x")]
        goal, place = (layout.state_names.index(name) for name in ("goal_x", here))
        towards = torch.sign(state[..., goal] - state[..., place])
        along = layout.action_names.index("delta_x")
        there, back = action.clone(), action.clone()
        there[..., along], back[..., along] = towards, -towards
        slope = self.critics.first(inputs, there) - self.critics.first(inputs, back)
        return {"q/slope": slope.mean(dim=1)}

    # --- Act -----------------------------------------------------------------

    def agents(self, number: int) -> dict[str, AgentActor]:
        """One seed's actors as they are now."""
        return self.actors.agents(number)

    # --- State ---------------------------------------------------------------

    def state(self, number: int) -> dict[str, Any]:
        """Everything that one seed needs to act and to resume bit-equally."""
        own = parts_state(self._parts(), number)
        return {"step": self.step, **own, "batches": self._batches.state(number)}

    def load_states(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Continue all seeds from their ``state``."""
        self.step = states[0]["step"]
        load_parts(self._parts(), states)
        self._batches.load_states([state["batches"] for state in states])

    def _parts(self) -> Parts:
        return {
            "actors": self.actors,
            "target_actors": self._target_actors,
            "critics": self.critics,
            "target_critics": self._target_critics,
        }


TABLE_3: dict[str, Any] = {
    "updates": 100_000,  # Table 3; 180,000 in Table 4
    "batch_size": 256,  # Table 3
    "actor_learning_rate": 5e-4,  # Table 3
    "critic_learning_rate": 5e-4,  # Table 3
    "discount": 0.95,  # Table 3
    "target_rate": 0.005,  # Table 3
    "q_weight": 2.5,  # Fujimoto & Gu 2021
    "q_weight_end": None,
    "policy_delay": 2,  # Fujimoto 2018
    "target_noise": 0.1,  # Table 3: "Standard deviation", of what it does not say
    "target_noise_clip": 0.5,  # Fujimoto 2018
    "future": 0.0,
    "elsewhere": 0.0,
    "imitate": "all",
    "imitation_weights": (1.0, 1.0, 1.0, 1.0),
    "imitation_scaled": False,
    "clip_targets": False,
    "layer_norm": False,
}
"""Table 3, and the cited source's choice where it is silent; ours in hidden layers and
the floor of deviations."""

ALGORITHMS.add(
    "td3-bc",
    Algorithm(
        about="TD3+BC: one agent that sees and sets everything (paper, Algorithm 2).",
        source="Fujimoto & Gu 2021",
        learner=Td3Bc,
        presets={TUNED: Td3BcConfig(), PAPER: Td3BcConfig(**TABLE_3)},
    ),
)
