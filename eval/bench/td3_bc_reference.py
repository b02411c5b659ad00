"""TD3+BC as its authors wrote it, to time ours against and to check what it learns.

Restated from github.com/sfujim/TD3_BC (MIT licence, Fujimoto & Gu 2021): the same
networks, sampling, losses and order of steps, and nothing of ours.
"""

from copy import deepcopy

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from marl_mm.algorithms.replay import normalized_actions
from marl_mm.algorithms.td3_bc_config import Td3BcConfig
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.envs.tasks.reach import LAYOUT


class PlainActor(nn.Module):
    """Two hidden layers; actions in [-1, 1]."""

    def __init__(self, units: int) -> None:
        super().__init__()
        self.l1 = nn.Linear(len(LAYOUT.state), units)
        self.l2 = nn.Linear(units, units)
        self.l3 = nn.Linear(units, len(LAYOUT.action))

    def forward(self, state: torch.Tensor) -> torch.Tensor:
        """Shapes (n, 10) to (n, 4)."""
        hidden = functional.relu(self.l1(state))
        hidden = functional.relu(self.l2(hidden))
        return torch.tanh(self.l3(hidden))


class PlainCritic(nn.Module):
    """Two values of a state and an action."""

    def __init__(self, units: int) -> None:
        super().__init__()
        width = len(LAYOUT.state) + len(LAYOUT.action)
        self.l1, self.l4 = nn.Linear(width, units), nn.Linear(width, units)
        self.l2, self.l5 = nn.Linear(units, units), nn.Linear(units, units)
        self.l3, self.l6 = nn.Linear(units, 1), nn.Linear(units, 1)

    def forward(
        self, state: torch.Tensor, action: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Shapes (n, 10) and (n, 4) to twice (n, 1)."""
        inputs = torch.cat([state, action], 1)
        hidden = functional.relu(self.l4(inputs))
        hidden = functional.relu(self.l5(hidden))
        return self._first(inputs), self.l6(hidden)

    def q1(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """The first value alone."""
        return self._first(torch.cat([state, action], 1))

    def _first(self, inputs: torch.Tensor) -> torch.Tensor:
        hidden = functional.relu(self.l1(inputs))
        hidden = functional.relu(self.l2(hidden))
        value: torch.Tensor = self.l3(hidden)
        return value


class PlainTd3Bc:
    """The authors' algorithm.

    Args:
        arrays: Episodes of the dataset.
        config: Batch, rates, discount, noise and c; the first hidden layer's units.
        seed: Seed of networks, batches and noise.
    """

    def __init__(self, arrays: EpisodeArrays, config: Td3BcConfig, seed: int) -> None:
        torch.manual_seed(seed)
        self._rng = np.random.default_rng(seed)
        units, self.config = config.hidden[0], config
        self.actor, self.critic = PlainActor(units), PlainCritic(units)
        self.actor_target, self.critic_target = deepcopy((self.actor, self.critic))
        rates = config.actor_learning_rate, config.critic_learning_rate
        self.actor_optimizer = torch.optim.Adam(self.actor.parameters(), rates[0])
        self.critic_optimizer = torch.optim.Adam(self.critic.parameters(), rates[1])
        states = arrays.states[~arrays.is_last_state()]
        self.mean, self.std = states.mean(axis=0), states.std(axis=0) + 1e-3
        next_states = arrays.states[~arrays.is_first_state()]
        self._buffer = (
            (states - self.mean) / self.std,
            normalized_actions(arrays.actions, arrays.layout),
            (next_states - self.mean) / self.std,
            arrays.rewards[:, None],
            1.0 - arrays.terminated[:, None],
        )
        self._updates = 0

    def _sample(self) -> list[torch.Tensor]:
        rows = self._rng.integers(len(self._buffer[0]), size=self.config.batch_size)
        return [torch.FloatTensor(column[rows]) for column in self._buffer]

    def update(self) -> None:
        """One gradient step of the critics, every second time one of the actor."""
        state, action, next_state, reward, not_done = self._sample()
        noise = torch.randn_like(action)
        self.learn(state, action, next_state, reward, not_done, noise)

    def learn(
        self,
        state: torch.Tensor,
        action: torch.Tensor,
        next_state: torch.Tensor,
        reward: torch.Tensor,
        not_done: torch.Tensor,
        noise: torch.Tensor,
    ) -> None:
        """The step on these transitions; noise is standard normal, shape (n, 4)."""
        config = self.config
        self._updates += 1
        with torch.no_grad():
            clip = config.target_noise_clip
            noise = noise * config.target_noise
            next_action = self.actor_target(next_state) + noise.clamp(-clip, clip)
            q1, q2 = self.critic_target(next_state, next_action.clamp(-1, 1))
            target = reward + not_done * config.discount * torch.min(q1, q2)
        current1, current2 = self.critic(state, action)
        loss = functional.mse_loss(current1, target)
        loss = loss + functional.mse_loss(current2, target)
        self.critic_optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self.critic_optimizer.step()

        if self._updates % config.policy_delay:
            return
        pi = self.actor(state)
        value = self.critic.q1(state, pi)
        weight = config.q_weight / value.abs().mean().detach()
        loss = -weight * value.mean() + functional.mse_loss(pi, action)
        self.actor_optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self.actor_optimizer.step()
        for network, copy in (
            (self.critic, self.critic_target),
            (self.actor, self.actor_target),
        ):
            pairs = zip(network.parameters(), copy.parameters(), strict=True)
            for leader, follower in pairs:
                tau = config.target_rate
                follower.data.copy_(tau * leader.data + (1 - tau) * follower.data)
