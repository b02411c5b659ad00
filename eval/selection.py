"""Scores of trained policies that cost no episode of their own.

Which of several policies to take to the robot has to be said from the data alone:

- the value of the first states by fitted Q evaluation (Le 2019, arXiv 1903.08738), with
  a critic that sees everything, and with one for each agent that sees and sets only
  what that agent does;
- the distance to the actions of the data.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from marl_mm.algorithms.ensemble import Ensemble, Learner
from marl_mm.algorithms.networks import Normalizer, perceptron
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.datasets.arrays import EpisodeArrays

UPDATES, BATCH = 3_000, 256
"""Gradient steps of fitted Q evaluation, and steps in a batch of each."""

DISCOUNT = 0.99
"""Discount of the values."""

HIDDEN = 128, 128
"""Widths of the critics' hidden layers."""

RATE, TARGET_RATE = 1e-3, 0.05
"""Learning rate, and share of the way that targets go to the critics at each update."""

_FLOOR = 0.01
"""Least standard deviation of an entry of the state."""


class Scores(NamedTuple):
    """Scores of a policy; by all of them more is better."""

    fqe: float
    """Mean value of the data's first states by a critic of joint states and actions."""

    fqe_agents: float
    """The same by a critic for each agent, mean over agents."""

    cloning: float
    """Minus the mean square distance to the data's actions, in halves of ranges."""


def scores(
    policy: LearnedPolicy,
    arrays: EpisodeArrays,
    seed: int = 0,
    updates: int = UPDATES,
) -> Scores:
    """Scores of a policy, from data whose rewards are those of its task.

    Args:
        policy: The policy; of a plan of several actions the first counts.
        arrays: Episodes.
        seed: Seed of critics, batches, and noise of policies that draw.
        updates: Number of gradient steps of fitted Q evaluation.
    """
    layout = arrays.layout
    low, high = (
        torch.tensor([getattr(entry, end) for entry in layout.action])
        for end in ("low", "high")
    )
    states = torch.as_tensor(arrays.states, dtype=torch.float32)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        by_policy = (_actions(policy, states) - low) / (high - low) * 2 - 1
        has_action = torch.as_tensor(~arrays.is_last_state())
        taken = (torch.as_tensor(arrays.actions) - low) / (high - low) * 2 - 1
        distance = (by_policy[has_action] - taken).square().mean()
        joint, *by_agent = _fitted(arrays, states, by_policy, taken, updates)
    return Scores(joint, float(np.mean(by_agent)), -float(distance))


@torch.no_grad()
def _actions(policy: LearnedPolicy, states: torch.Tensor) -> torch.Tensor:
    """Joint actions at all states, shape (n, k)."""
    actions = torch.empty(len(states), len(policy.layout.action))
    for agent in policy.agents.values():
        width = agent.actor.noise
        noise = torch.randn(len(states), width) if width else None
        output = agent.actor(agent.observed(states), noise)
        actions[:, list(agent.layout.action)] = agent.planned(output)[:, 0]
    return actions


def _fitted(
    arrays: EpisodeArrays,
    states: torch.Tensor,
    by_policy: torch.Tensor,
    taken: torch.Tensor,
    updates: int,
) -> list[float]:
    """Mean values of first states, of the joint critic and then of each agent's."""
    first = torch.as_tensor(arrays.is_first_state())
    last = torch.as_tensor(arrays.is_last_state())
    states = Normalizer.of(states, _FLOOR)(states)
    inputs = torch.cat([states[~last], taken], dim=1)
    next_inputs = torch.cat([states[~first], by_policy[~first]], dim=1)
    first_inputs = torch.cat([states[first], by_policy[first]], dim=1)
    reward = torch.as_tensor(arrays.rewards, dtype=torch.float32)
    discount = DISCOUNT * (1 - torch.as_tensor(arrays.terminated).float())
    masks = _masks(arrays)
    widths = inputs.shape[1], *HIDDEN, 1
    members = [nn.Sequential(*perceptron(widths, layer_norm=True)) for _ in masks]
    critics = Ensemble(members)
    targets, learner = critics.copy(), Learner(critics, RATE)
    for _ in range(updates):
        picked = torch.randint(len(inputs), (BATCH,))
        with torch.no_grad():
            value = targets(masks * next_inputs[picked])[..., 0]
            target = reward[picked] + discount[picked] * value
        error = critics(masks * inputs[picked])[..., 0] - target
        learner.descend(error.square().mean(dim=1).sum())
        targets.follow(critics, TARGET_RATE)
    with torch.no_grad():
        values = critics(masks * first_inputs)[..., 0].mean(dim=1)
    return [float(value) for value in values]


def _masks(arrays: EpisodeArrays) -> torch.Tensor:
    """What each critic sees of a state and action, shape (1 + agents, 1, d + k)."""
    layout = arrays.layout
    width = len(layout.state)
    masks = torch.zeros(1 + len(layout.agents), 1, width + len(layout.action))
    masks[0] = 1.0
    for mask, agent in zip(masks[1:, 0], layout.agents, strict=True):
        mask[list(agent.observation)] = 1.0
        mask[[width + index for index in agent.action]] = 1.0
    return masks
