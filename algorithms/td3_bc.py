"""TD3+BC (paper, Algorithm 2; Fujimoto & Gu 2021): one actor that sees and sets all.

Loss of the twin critics: (Q_j(s, a) - r - gamma (1 - terminated) min_j Q_j'(s', a'))^2,
where a' is the target actor's action with clipped noise. Every second update the actor
follows: -lambda Q_1(s, pi(s)) + MSE(a, pi(s)), where lambda = c / mean |Q_1(s, pi(s))|.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import torch

from marl_mm.algorithms.actors import AgentActor
from marl_mm.algorithms.networks import DIAGNOSED, Normalizer
from marl_mm.algorithms.offline_batches import OfflineBatch, OfflineBatches
from marl_mm.algorithms.replay import Judge, normalized_actions
from marl_mm.algorithms.seeded import (
    Parts,
    SeededActors,
    SeededCritics,
    imitation_errors,
    load_parts,
    parts_state,
)
from marl_mm.algorithms.td3_bc_config import LEAST_SPREAD, WEIGHTED, Td3BcConfig
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.layout import JOINT_NAME, AgentLayout


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
