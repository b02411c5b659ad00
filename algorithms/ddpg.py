"""DDPG, with and without hindsight (paper, Algorithm 1; Lillicrap 2016).

One actor and one critic on the joint state and action:
critic loss (Q(s, a) - r - gamma (1 - terminated) Q'(s', pi'(s')))^2,
actor loss -Q(s, pi(s)). With hindsight (HER, Andrychowicz 2017) most transitions are
replayed with a goal that their episode came to later. With ``imitation_weight`` w the
actor's loss at demonstrated actions has w [Q(s, a) > Q(s, pi(s))] (pi(s) - a)^2 as well
(Nair 2018).
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from typing import Any, ClassVar

import numpy as np
import torch
from torch.nn import functional
from torch.optim.swa_utils import get_ema_multi_avg_fn

from marl_mm.algorithms.actors import blank_actor, joint_action
from marl_mm.algorithms.ddpg_config import DdpgConfig
from marl_mm.algorithms.demonstrations import Demonstrations
from marl_mm.algorithms.diagnostics import DIAGNOSED, saturation
from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.networks import Adam, Critic, Normalizer
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.replay import (
    DRAWN_TOGETHER,
    Batch,
    Judge,
    Replay,
    concatenated,
    highest_target,
)
from marl_mm.algorithms.statistics import RunningStatistics
from marl_mm.episode import Episode
from marl_mm.layout import AgentLayout, Layout

_FAR = 20.0
"""Least distance at which what is reached widens an axis' scale: its root mean square
distance from the mean goal, in standard deviations of the goals. Before learning it is
at most 5 in Reach-v0 and its kin, and 37 to 300 where all goals are as far ahead."""


class Ddpg:
    """One actor and one critic, which learn from episodes as they come.

    Args:
        config: Hyper-parameters.
        judge: The task's reward and termination.
        seed: Seed of initial weights and batches.
        demonstrations: Episodes of others to learn from as well.
        layout: Layout of joint state and action.
    """

    base_name: ClassVar[str] = "ddpg"

    # --- Experience ----------------------------------------------------------

    def behaviour(self) -> Explorer:
        """Policy of the next episodes: at random until ``warm``, then with noise."""
        config = self.config
        share = config.random_share if self.warm else 1.0
        return Explorer(
            LearnedPolicy(self.name, self.agents, self.layout), config.noise, share
        )

    def observe(self, episode: Episode) -> None:
        """Add an episode to replay and input statistics."""
        self.replay.add(episode)
        self.episodes += 1
        self.env_steps += len(episode)
        self._statistics.add(episode.states)
        if self._reached is not None:
            self._reached.add(episode.states[:, self.layout.achieved])

    # --- Update --------------------------------------------------------------

    def learn(self, updates: int) -> dict[str, float]:
        """Many updates; their mean losses."""
        self._set_statistics()
        sums: dict[str, float] = {}
        for batch in self._batches(updates):
            for key, value in self.update(batch).items():
                sums[key] = sums.get(key, 0.0) + value
        return {key: value / updates for key, value in sums.items()}

    def update(self, batch: Batch) -> dict[str, float]:
        """One gradient step of critic and actor; their losses."""
        self.updates += 1
        state, next_state = batch.observation, batch.next_observation

        with torch.no_grad():
            next_action = joint_action(self._target_agents, next_state)
            next_value = self._target_critic(next_state, next_action)
            alive = 1 - batch.terminated
            target = batch.reward + self.config.discount * alive * next_value
            target.clamp_max_(self._highest_target)  # ours; in the paper it is infinite

        critic_loss = functional.mse_loss(self.critic(state, batch.action), target)
        self._critic_optimizer.descend(critic_loss)

        actor_loss = self._actor_loss(batch)
        if self._shown and self.config.imitation_weight:
            actor_loss = actor_loss + self._imitation_loss(batch)
        self._actor_optimizer.descend(actor_loss)

        self._follow(self._targets, self._online, None)
        return {"loss/critic": critic_loss.item(), "loss/actor": actor_loss.item()}

    def _actor_loss(self, batch: Batch) -> torch.Tensor:
        action = joint_action(self.agents, batch.observation)
        value = self.critic(batch.observation, action)
        loss: torch.Tensor = -value.mean()
        # Ours; in the paper the penalty is 0.
        return loss + self.config.action_penalty * action.square().mean()

    def _imitation_loss(self, batch: Batch) -> torch.Tensor:
        """Error at the demonstrated actions that the critic prefers (Nair 2018)."""
        state, shown = (x[-self._shown :] for x in (batch.observation, batch.action))
        action = joint_action(self.agents, state)
        with torch.no_grad():
            better = self.critic(state, shown) > self.critic(state, action)
        error = (action - shown).square().mean(dim=-1)
        loss: torch.Tensor = self.config.imitation_weight * (better * error).mean()
        return loss

    # --- Networks ------------------------------------------------------------

    def __init__(
        self,
        config: DdpgConfig,
        judge: Judge,
        seed: int,
        demonstrations: Sequence[Episode],
        layout: Layout,
    ) -> None:
        self.config, self.layout = config, layout
        self.name = self.base_name + "-her" * (config.hindsight > 0)
        self.episodes = self.env_steps = self.updates = 0
        self.replay = Replay(config.capacity, config.hindsight, judge, layout)
        self._highest_target = highest_target(judge, config.clip_targets)
        self._demonstrations = Demonstrations(
            demonstrations, config.demonstration_successes, config.hindsight, judge
        )
        share = config.demonstration_share if self._demonstrations else 0.0
        self._shown = round(share * config.batch_size)  # at the end of each batch
        self._rng = np.random.default_rng(seed)
        self._statistics = RunningStatistics(len(layout.state), config.std_floor)
        self._reached: RunningStatistics | None = None
        if config.hindsight:
            self._reached = RunningStatistics(len(layout.desired), config.std_floor)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.critic = Critic(
                Normalizer.blank(len(layout.state)),
                len(layout.action),
                config.hidden,
                layer_norm=config.layer_norm,
            )
            self.agents = {
                agent.name: blank_actor(agent, config.hidden)
                for agent in self._layouts()
            }
        self._target_critic = deepcopy(self.critic)
        self._target_agents = deepcopy(self.agents)
        actors = [p for a in self.agents.values() for p in a.actor.parameters()]
        self._critic_optimizer = Adam(
            self.critic.parameters(), config.critic_learning_rate
        )
        self._actor_optimizer = Adam(actors, config.actor_learning_rate)
        self._online = [*self.critic.parameters(), *actors]
        self._targets = [
            *self._target_critic.parameters(),
            *(p for a in self._target_agents.values() for p in a.actor.parameters()),
        ]
        self._follow = get_ema_multi_avg_fn(1 - config.target_rate)  # type: ignore[no-untyped-call]

    def _layouts(self) -> tuple[AgentLayout, ...]:
        """Layout of each actor."""
        return (self.layout.joint,)

    # --- Batches -------------------------------------------------------------

    @property
    def warm(self) -> bool:
        """Whether there is enough experience to learn from."""
        return self.env_steps >= self.config.warm_up

    def _batches(self, count: int) -> Iterator[Batch]:
        """Batches, drawn many at a time: relabelling costs hardly more for many."""
        own = self.config.batch_size - self._shown
        sources = (self.replay, own), (self._demonstrations, self._shown)
        while count:
            many = min(count, DRAWN_TOGETHER)
            parts = [
                source.sample(many * part, self._rng).split(part)
                for source, part in sources
                if part
            ]
            for batches in zip(*parts, strict=True):
                yield concatenated(batches)
            count -= many

    def _set_statistics(self) -> None:
        """Set the input statistics of all networks to those of the experience."""
        mean, std = self._statistics.mean, self._statistics.std
        if self._reached is not None:
            self._scale_by(self._reached, mean, std)
        for critic in (self.critic, self._target_critic):
            critic.normalizer.set(mean, std)
        for agent in (*self.agents.values(), *self._target_agents.values()):
            entries = list(agent.layout.observation)
            agent.actor.normalizer.set(mean[entries], std[entries])

    def _scale_by(
        self, reached: RunningStatistics, mean: torch.Tensor, std: torch.Tensor
    ) -> None:
        """Scale goals by what is reached, too, along axes where that is far from them.

        In hindsight it becomes the goal, and would be up to hundreds of deviations away
        where goals hardly differ. Ours; Andrychowicz 2017 scales all exchanged goals.

        Args:
            reached: Statistics of what is reached.
            mean: Means of the inputs, which change.
            std: Standard deviations of the inputs, which change.
        """
        goal = self.layout.goal
        gap, variance = reached.mean - mean[goal], std[goal].square()
        far = reached.std.square() + gap.square() > _FAR**2 * variance
        # Variance of an equal mixture of goals and of what is reached.
        mixed = (variance + reached.std.square()) / 2 + (gap / 2).square()
        mean[goal] = torch.where(far, mean[goal] + gap / 2, mean[goal])
        std[goal] = torch.where(far, mixed.sqrt(), std[goal])

    @torch.no_grad()
    def diagnose(self) -> dict[str, float]:
        """Metrics of critic and actor on a batch of the replay."""
        rng = np.random.default_rng(self.updates)
        batch = self.replay.sample(DIAGNOSED, rng)
        action = joint_action(self.agents, batch.observation)
        taken = self.critic(batch.observation, batch.action)
        alpha = {}
        if "alpha" in self.layout.action_names:
            place = self.layout.action_names.index("alpha")
            alpha = {"action/alpha": ((action[:, place] + 1) / 2).mean().item()}
        return {
            "q/data": taken.mean().item(),
            "q/policy": self.critic(batch.observation, action).mean().item(),
            "action/saturation": saturation(action).item(),
            **alpha,
        }

    # --- State ---------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """State with which it acts and resumes bit-equally."""
        return {
            "episodes": self.episodes,
            "env_steps": self.env_steps,
            "updates": self.updates,
            "actors": {n: a.actor.state_dict() for n, a in self.agents.items()},
            "critic": self.critic.state_dict(),
            "target_actors": {
                n: a.actor.state_dict() for n, a in self._target_agents.items()
            },
            "target_critic": self._target_critic.state_dict(),
            "actor_optimizer": self._actor_optimizer.state_dict(),
            "critic_optimizer": self._critic_optimizer.state_dict(),
            "statistics": self._statistics.state(),
            **({"reached": self._reached.state()} if self._reached else {}),
            "replay": self.replay.state(),
            "rng": json.dumps(self._rng.bit_generator.state),
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a ``state``."""
        self.episodes, self.env_steps = state["episodes"], state["env_steps"]
        self.updates = state["updates"]
        for name, agent in self.agents.items():
            agent.actor.load_state_dict(state["actors"][name])
            target = self._target_agents[name].actor
            target.load_state_dict(state["target_actors"][name])
        self.critic.load_state_dict(state["critic"])
        self._target_critic.load_state_dict(state["target_critic"])
        self._actor_optimizer.load_state_dict(state["actor_optimizer"])
        self._critic_optimizer.load_state_dict(state["critic_optimizer"])
        self._statistics.load_state(state["statistics"])
        if "reached" not in state:  # as older ones, which go on as they began
            self._reached = None
        elif self._reached is not None:
            self._reached.load_state(state["reached"])
        self.replay.load_state(state["replay"])
        self._rng.bit_generator.state = json.loads(state["rng"])
