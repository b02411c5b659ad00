"""ReBRAC and MA-ReBRAC: updates by hand, and games with known ends."""

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional

from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.rebrac import MaRebrac, Rebrac
from marl_mm.algorithms.rebrac_config import RebracConfig
from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.envs.registry import make_task
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from tests.algorithms.games import NoJudge, learnt, played, steps_of, team
from tests.algorithms.test_teams import XOR, conventions

JUDGE = make_task("Reach-v0")
KINDS = Rebrac, MaRebrac


@pytest.fixture
def arrays(make_episode: Callable[..., Episode]) -> EpisodeArrays:
    return arrays_of([make_episode(i, 3 + i % 4, i % 3 > 0) for i in range(20)], "x")


class Plain:
    """The update once more, with a network for each critic and actor."""

    def __init__(self, learner: Rebrac) -> None:
        self.config, self.layouts = learner.config, learner.layouts
        self.normalizer = learner.normalizer
        agents = learner.agents(0)
        self.actors = [deepcopy(agents[a.name].actor.layers) for a in self.layouts]
        self.critics = [critic_of(state) for state in learner.state(0)["critics"]]
        self.targets = deepcopy((self.actors, self.critics))
        rate = self.config.learning_rate
        of_critics = [p for critic in self.critics for p in critic.parameters()]
        self.critic_adam = torch.optim.Adam(of_critics, rate)
        self.adams = [torch.optim.Adam(a.parameters(), rate) for a in self.actors]
        self.step = 0

    def act(self, actors: list[Any], state: torch.Tensor) -> list[torch.Tensor]:
        pairs = zip(actors, self.layouts, strict=True)
        return [torch.tanh(net(state[:, list(a.observation)])) for net, a in pairs]

    def update(self, batch: OfflineBatch) -> None:
        self.step += 1
        config, b = self.config, OfflineBatch(*(column[0] for column in batch))
        state, after = map(self.normalizer, (b.observation, b.next_observation))
        with torch.no_grad():
            clip = config.target_noise_clip
            noise = (config.target_noise * b.noise).clamp(-clip, clip)
            acted = torch.cat(self.act(self.targets[0], after), dim=1) + noise
            acted = acted.clamp(-1.0, 1.0)
            one, two = (q(torch.cat([after, acted], 1))[:, 0] for q in self.targets[1])
            away = ((acted - b.next_action) ** 2).sum(dim=1)
            away = torch.where(b.imitated > 0, away, 0.0)
            then = torch.min(one, two) - config.critic_weight * away
            target = b.reward + config.discount * (1 - b.terminated) * then
            target = target.clamp(max=10.0)
        known = torch.cat([state, b.action], dim=1)
        losses = [functional.mse_loss(q(known)[:, 0], target) for q in self.critics]
        stepped(self.critic_adam, losses[0] + losses[1])
        if self.step % config.policy_delay:
            return
        before = [part.detach() for part in self.act(self.actors, state)]
        for number, layout in enumerate(self.layouts):
            own = self.act(self.actors, state)[number]
            parts = [*before[:number], own, *before[number + 1 :]]
            inputs = torch.cat([state, *parts], dim=1)
            one, two = (q(inputs)[:, 0] for q in self.critics)
            value = torch.min(one, two)
            away = ((own - b.action[:, list(layout.action)]) ** 2).sum(dim=1)
            away = torch.where(b.imitated > 0, away, 0.0)
            scale = value.abs().mean().item()
            stepped(
                self.adams[number],
                (config.actor_weight * away - value / scale).mean(),
            )
        self.follow(self.targets[0], self.actors)
        self.follow(self.targets[1], self.critics)

    def follow(self, targets: list[Any], networks: list[Any]) -> None:
        rate = self.config.target_rate
        for target, network in zip(targets, networks, strict=True):
            pairs = zip(target.parameters(), network.parameters(), strict=True)
            for old, new in pairs:
                old.data = (1 - rate) * old.data + rate * new.data


def critic_of(state: dict[str, torch.Tensor]) -> nn.Sequential:
    """A critic of one hidden layer, normalised, with these weights."""
    units, inputs = state["0.weight"].shape
    layers = nn.Linear(inputs, units), nn.LayerNorm(units), nn.ReLU()
    critic = nn.Sequential(*layers, nn.Linear(units, 1))
    critic.load_state_dict(state)
    return critic


def stepped(adam: torch.optim.Adam, loss: torch.Tensor) -> None:
    adam.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    adam.step()


@pytest.mark.parametrize("kind", KINDS)
def test_updates_by_hand(arrays: EpisodeArrays, kind: type[Rebrac]) -> None:
    """Three of them, of which the second moves actors and targets."""
    config = RebracConfig(
        hidden=(16,), batch_size=32, future=0.2, elsewhere=0.4, critic_weight=0.5
    )
    learner, other = (kind(config, arrays, JUDGE, [3]) for _ in range(2))
    plain = Plain(other)
    for _ in range(3):
        learner.update()
        plain.update(other._batches.next())
    found = learner.state(0)
    expected = {
        "actors": plain.actors,
        "target_actors": plain.targets[0],
        "critics": plain.critics,
        "target_critics": plain.targets[1],
    }
    for name, networks in expected.items():
        states = found[name].values() if "actors" in name else found[name]
        for state, network in zip(states, networks, strict=True):
            prefix = "layers." if "actors" in name else ""
            for key, value in network.state_dict().items():
                torch.testing.assert_close(
                    state[prefix + key], value, atol=1e-6, rtol=1e-5
                )


@pytest.mark.slow
def test_the_better_convention_draws_as_far_as_imitation_lets_it() -> None:
    """Where the value rises evenly from 0 to 1 on the way between the conventions, t
    from -1 to 1, the loss 2 beta t^2 - log(1 + t) is least where 4 beta t (1 + t) = 1.
    """
    data = conventions(rewards=(1.0, 0.0))
    quick: dict[str, Any] = {"updates": 300, "learning_rate": 4e-3}
    for name in ("rebrac", "ma-rebrac"):
        free = played(learnt(name, data, actor_weight=0.01, **quick), episodes=1)
        np.testing.assert_allclose(free[0, 0], XOR[0], atol=0.15)
        bound = played(learnt(name, data, actor_weight=1.0, **quick), episodes=1)
        way = (bound[0, 0] * XOR[0]).mean()
        assert way == pytest.approx((np.sqrt(2.0) - 1.0) / 2.0, abs=0.1)


@pytest.mark.slow
def test_a_step_pays_for_the_distance_from_the_next() -> None:
    """Agents clone the mean of the second step's actions, which is 0."""
    second = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 2))
    actions = np.stack([np.zeros((200, 2)), second], axis=1)
    rewards = np.tile([0.0, 1.0], 200)
    data = steps_of(actions.reshape(400, 2), rewards, team(), length=2)
    usual: dict[str, Any] = {"hidden": (32, 32), "batch_size": 64, "target_noise": 0.0}
    rates: dict[str, Any] = {"target_rate": 0.05, "learning_rate": 2e-3}
    values = []
    for weight in (0.0, 1.0):
        config = RebracConfig(
            actor_weight=100.0, critic_weight=weight, **usual, **rates
        )
        learner = MaRebrac(config, data, NoJudge(), [0])
        state = learner.normalizer(torch.zeros(1, 1, 2))
        for _ in range(300):
            learner.update()
        lately = []
        for _ in range(100):
            learner.update()
            lately.append(learner.critics.least(state, torch.zeros(1, 1, 2)).item())
        values.append(np.mean(lately))
    assert values[0] == pytest.approx(config.discount, abs=0.05)
    away = (second**2).sum(axis=1).mean()
    assert values[0] - values[1] == pytest.approx(config.discount * away, abs=0.07)


def test_weights_below_0_are_refused() -> None:
    for name in ("actor_weight", "critic_weight", "target_noise"):
        with pytest.raises(UsageError, match=f"{name} is -1"):
            RebracConfig(**{name: -1.0})  # type: ignore[arg-type]
