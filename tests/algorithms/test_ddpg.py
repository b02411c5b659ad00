"""DDPG and MADDPG: updates by hand, what actors see, self-sufficient checkpoints."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from marl_mm.algorithms.actors import joint_action
from marl_mm.algorithms.checkpoint import FILE, checkpoint, policy_checkpoint
from marl_mm.algorithms.ddpg import Ddpg
from marl_mm.algorithms.ddpg_config import DdpgConfig
from marl_mm.algorithms.maddpg import Maddpg
from marl_mm.algorithms.maddpg_config import MaddpgConfig
from marl_mm.algorithms.networks import Actor, Critic
from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.algorithms.registry import preset
from marl_mm.algorithms.replay import Batch
from marl_mm.algorithms.statistics import RunningStatistics
from marl_mm.envs.registry import make_task
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.errors import UsageError

MakeEpisode = Callable[..., Episode]
JUDGE = make_task()
SMALL = {"hidden": (16, 16), "batch_size": 32, "warm_up": 0, "capacity": 2000}
KINDS = (
    (Ddpg, DdpgConfig(**SMALL)),  # type: ignore[arg-type]
    (Maddpg, MaddpgConfig(**SMALL)),  # type: ignore[arg-type]
    (Maddpg, MaddpgConfig(others="replay", **SMALL)),  # type: ignore[arg-type]
    (Ddpg, DdpgConfig(layer_norm=False, clip_targets=False, **SMALL)),  # type: ignore[arg-type]
)


@pytest.fixture
def episodes(make_episode: MakeEpisode) -> list[Episode]:
    return [make_episode(i, steps=10, success=i % 2 == 0) for i in range(20)]


def taught(
    kind: type[Ddpg], config: DdpgConfig, episodes: list[Episode], seed: int = 0
) -> Ddpg:
    algorithm = kind(config, JUDGE, seed, (), REACH)
    for episode in episodes:
        algorithm.observe(episode)
    return algorithm


def batch_of(algorithm: Ddpg, size: int = 32) -> Batch:
    return algorithm.replay.sample(size, np.random.default_rng(5))


def layers(network: Actor | Critic) -> list[torch.Tensor]:
    """Weights and biases, in double precision."""
    return [p.detach().double().requires_grad_() for p in network.layers.parameters()]


def perceptron(weights: list[torch.Tensor], inputs: torch.Tensor) -> torch.Tensor:
    """Three linear layers written out; hidden ones normalised if there are gains."""
    *hidden, w3, b3 = weights
    per_layer = len(hidden) // 2
    for layer in (hidden[:per_layer], hidden[per_layer:]):
        inputs = inputs @ layer[0].T + layer[1]
        if per_layer == 4:
            off = inputs - inputs.mean(1, keepdim=True)
            inputs = off / ((off**2).mean(1, keepdim=True) + 1e-5).sqrt()
            inputs = layer[2] * inputs + layer[3]
        inputs = inputs.clamp_min(0)
    return inputs @ w3.T + b3


@pytest.mark.parametrize(("kind", "config"), KINDS)
def test_one_update_equals_the_hand_written_one(
    kind: type[Ddpg], config: DdpgConfig, episodes: list[Episode]
) -> None:
    """Target, critic, actors, target networks, in double precision and without torch's
    modules and optimisers; Adam's first step is lr g / (|g| + eps)."""
    algorithm = taught(kind, config, episodes)
    algorithm.learn(3)  # targets differ from networks, statistics are set
    fresh = kind(config, JUDGE, 0, (), REACH)  # fresh optimisers
    state = algorithm.state()
    for name in ("actor_optimizer", "critic_optimizer"):
        state[name] = fresh.state()[name]
    algorithm.load_state(state)
    batch = batch_of(algorithm)
    s, a, r, s2, end = (column.double() for column in batch)
    mean = algorithm.critic.normalizer.mean.double()
    std = algorithm.critic.normalizer.std.double()

    def acts(
        actors: list[list[torch.Tensor]], states: torch.Tensor
    ) -> list[torch.Tensor]:
        normal = (states - mean) / std
        return [
            torch.tanh(perceptron(w, normal[:, list(layout.observation)]))
            for w, layout in zip(actors, algorithm._layouts(), strict=True)
        ]

    def values(
        critic: list[torch.Tensor], states: torch.Tensor, action: torch.Tensor
    ) -> torch.Tensor:
        return perceptron(critic, torch.cat([(states - mean) / std, action], 1))[:, 0]

    critic = layers(algorithm.critic)
    actors = [layers(agent.actor) for agent in algorithm.agents.values()]
    target_critic = layers(algorithm._target_critic)
    target_actors = [layers(a.actor) for a in algorithm._target_agents.values()]

    next_action = torch.cat(acts(target_actors, s2), 1)
    target = r + 0.95 * (1 - end) * values(target_critic, s2, next_action)
    if config.clip_targets:
        assert (target > 10).any()
        target = target.clamp_max(10.0)
    critic_loss = ((values(critic, s, a) - target.detach()) ** 2).mean()
    critic_gradients = torch.autograd.grad(critic_loss, critic)

    def stepped(
        weights: list[torch.Tensor], gradients: tuple[torch.Tensor, ...]
    ) -> list[torch.Tensor]:
        pairs = zip(weights, gradients, strict=True)
        return [w - 1e-3 * g / (g.abs() + 1e-8) for w, g in pairs]

    critic = stepped(critic, critic_gradients)
    own = acts(actors, s)
    if getattr(config, "others", "policy") == "policy":
        action = torch.cat(own, 1)
        actor_loss = -values(critic, s, action).mean()
        actor_loss = actor_loss + config.action_penalty * (action**2).mean()
    else:
        first = torch.cat([own[0], a[:, 3:]], 1)
        second = torch.cat([a[:, :3], own[1]], 1)
        actor_loss = -values(critic, s, first).mean() - values(critic, s, second).mean()
        penalty = (torch.cat(own, 1) ** 2).mean()
        actor_loss = actor_loss + config.action_penalty * penalty
    flat = [w for weights in actors for w in weights]
    moved = stepped(flat, torch.autograd.grad(actor_loss, flat))

    losses = algorithm.update(batch)

    assert losses["loss/critic"] == pytest.approx(critic_loss.item(), rel=1e-5)
    assert losses["loss/actor"] == pytest.approx(actor_loss.item(), rel=1e-5, abs=1e-6)
    after = [p for x in algorithm.agents.values() for p in x.actor.layers.parameters()]
    for theirs, ours in zip(
        [*critic, *moved],
        [*algorithm.critic.layers.parameters(), *after],
        strict=True,
    ):
        torch.testing.assert_close(ours.double(), theirs, atol=2e-6, rtol=0)
    for theirs, new, old in zip(
        algorithm._target_critic.layers.parameters(), critic, target_critic, strict=True
    ):
        tracked = 0.995 * old + 0.005 * new
        torch.testing.assert_close(theirs.double(), tracked, atol=2e-6, rtol=0)
    trackers = [
        p
        for a in algorithm._target_agents.values()
        for p in a.actor.layers.parameters()
    ]
    before = [w for weights in target_actors for w in weights]
    for theirs, new, old in zip(trackers, moved, before, strict=True):
        tracked = 0.995 * old + 0.005 * new
        torch.testing.assert_close(theirs.double(), tracked, atol=1e-7, rtol=0)
        assert not torch.equal(new, old)


def test_an_actors_gradient_does_not_reach_what_it_cannot_see(
    episodes: list[Episode],
) -> None:
    algorithm = taught(Maddpg, KINDS[1][1], episodes)
    algorithm.learn(2)
    state = batch_of(algorithm).observation.clone().requires_grad_()
    action = joint_action(algorithm.agents, state)
    for layout in REACH.agents:
        own = action[:, list(layout.action)].sum()
        (gradient,) = torch.autograd.grad(own, state, retain_graph=True)
        unseen = [i for i in range(10) if i not in layout.observation]
        assert (gradient[:, unseen] == 0).all()
        assert (gradient[:, list(layout.observation)] != 0).any(dim=0).all()


def test_with_present_actions_the_loss_moves_every_agent(
    episodes: list[Episode],
) -> None:
    algorithm = taught(Maddpg, KINDS[1][1], episodes)
    algorithm.learn(2)
    loss = algorithm._actor_loss(batch_of(algorithm))
    for agent in algorithm.agents.values():
        parameters = list(agent.actor.parameters())
        gradients = torch.autograd.grad(loss, parameters, retain_graph=True)
        assert all((gradient != 0).any() for gradient in gradients)


def test_with_replayed_actions_an_agents_loss_moves_nobody_else(
    episodes: list[Episode],
) -> None:
    config = MaddpgConfig(others="replay", **SMALL)  # type: ignore[arg-type]
    algorithm = taught(Maddpg, config, episodes)
    assert isinstance(algorithm, Maddpg)
    algorithm.learn(2)
    batch = batch_of(algorithm)
    names = list(algorithm.agents)
    for name, other in (names, names[::-1]):
        loss = algorithm._agent_loss(name, batch)
        parameters = list(algorithm.agents[other].actor.parameters())
        gradients = torch.autograd.grad(loss, parameters, allow_unused=True)
        assert all(gradient is None for gradient in gradients)


def test_the_critic_sees_everything(episodes: list[Episode]) -> None:
    algorithm = taught(Maddpg, KINDS[1][1], episodes)
    algorithm.learn(2)
    batch = batch_of(algorithm)
    state = batch.observation.clone().requires_grad_()
    action = batch.action.clone().requires_grad_()
    value = algorithm.critic(state, action).sum()
    for gradient in torch.autograd.grad(value, (state, action)):
        assert (gradient != 0).any(dim=0).all()


@pytest.mark.slow
def test_critic_and_actor_solve_a_task_of_one_step(make_episode: MakeEpisode) -> None:
    """Reward 1 - |a - a*|^2, in [-1, 1], at the end of every episode of one step: the
    critic finds it, and the actor finds a*."""
    best = np.array([0.5, -0.3, 0.2, 0.8])
    config = DdpgConfig(
        hidden=(64, 64),
        warm_up=0,
        hindsight=0,
        action_penalty=0.0,
        actor_learning_rate=1e-4,  # the critic must lead
    )
    algorithm = Ddpg(config, JUDGE, 0, (), REACH)
    rng = np.random.default_rng(0)
    for i in range(600):
        episode = make_episode(i, steps=1, success=True)
        action = rng.uniform([-1, -1, -1, 0], 1, 4)
        reward = 1 - np.square((action - best) * [1, 1, 1, 2]).sum()
        algorithm.observe(
            replace(
                episode,
                states=np.zeros((2, 10)),
                actions=action[None].astype(np.float32),
                rewards=np.array([reward]),
            )
        )
    algorithm.learn(1500)
    policy = LearnedPolicy("ddpg", algorithm.agents, REACH)
    np.testing.assert_allclose(policy.act(np.zeros(10)), best, atol=0.1)


@pytest.mark.parametrize(("kind", "config"), KINDS)
def test_save_load_act_is_bit_equal(
    kind: type[Ddpg], config: DdpgConfig, episodes: list[Episode], tmp_path: Path
) -> None:
    algorithm = taught(kind, config, episodes)
    algorithm.learn(5)
    (tmp_path / FILE).write_bytes(checkpoint(algorithm))
    (tmp_path / "best.pt").write_bytes(policy_checkpoint(algorithm))
    policy = LearnedPolicy(algorithm.name, algorithm.agents, REACH)
    for loaded in (load_policy(tmp_path), load_policy(tmp_path / "best.pt")):
        assert loaded.name == algorithm.name
        for state in np.random.default_rng(2).normal(size=(20, 10)):
            np.testing.assert_array_equal(loaded.act(state), policy.act(state))


@pytest.mark.parametrize(("kind", "config"), KINDS)
def test_a_restored_algorithm_continues_bit_equally(
    kind: type[Ddpg], config: DdpgConfig, episodes: list[Episode], tmp_path: Path
) -> None:
    """Through a file: networks, optimisers, replay, statistics, random numbers."""
    algorithm = taught(kind, config, episodes[:10])
    algorithm.learn(4)
    (tmp_path / FILE).write_bytes(checkpoint(algorithm))
    saved = torch.load(tmp_path / FILE, weights_only=True)
    again = kind(config, JUDGE, 99, (), REACH)
    again.load_state(saved["state"])
    assert again.updates == algorithm.updates == 4
    assert again.diagnose() == algorithm.diagnose()
    for one in (algorithm, again):
        for episode in episodes[10:]:
            one.observe(episode)
    assert algorithm.learn(4) == again.learn(4)
    ours, theirs = algorithm.state(), again.state()
    for name, network in ours["actors"].items():
        for key, tensor in network.items():
            assert torch.equal(tensor, theirs["actors"][name][key])
    assert ours["rng"] == theirs["rng"]


def test_same_seed_same_weights_and_other_seed_others(
    episodes: list[Episode],
) -> None:
    runs = []
    for seed in (1, 1, 2):
        torch.rand(3)  # the global generator must not matter
        algorithm = taught(Ddpg, KINDS[0][1], episodes, seed)
        algorithm.learn(10)
        runs.append(list(algorithm.critic.parameters()))
    assert all(torch.equal(a, b) for a, b in zip(runs[0], runs[1], strict=True))
    assert not torch.equal(runs[0][0], runs[2][0])


def test_exploration_stays_in_the_action_space_and_is_its_episodes_own(
    episodes: list[Episode],
) -> None:
    config = replace(KINDS[0][1], noise=2.0, random_share=0.3)
    algorithm = taught(Ddpg, config, episodes)
    algorithm.learn(1)
    explorer = algorithm.behaviour()
    state = np.random.default_rng(0).normal(size=10)
    runs = []
    for seed in (4, 4, 5):
        explorer.begin(np.random.default_rng(seed), REACH)
        runs.append(np.array([explorer.act(state) for _ in range(50)]))
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0] != runs[2]).any()
    assert (runs[0] >= [-1, -1, -1, 0]).all() and (runs[0] <= 1).all()
    assert runs[0].dtype == np.float32


def test_noise_is_a_share_of_half_of_each_range(episodes: list[Episode]) -> None:
    """Around what the policy does, once it is asked."""
    config = replace(KINDS[0][1], random_share=0.0, noise=0.02)  # far from the bounds
    algorithm = taught(Ddpg, config, episodes)
    algorithm.learn(1)
    explorer, state = algorithm.behaviour(), np.zeros(10)
    policy = LearnedPolicy("ddpg", algorithm.agents, REACH)
    explorer.begin(np.random.default_rng(0), REACH)
    errors = [explorer.act(state) - policy.act(state) for _ in range(4000)]
    half = np.array([1, 1, 1, 0.5])
    expected = 0.02 * half
    np.testing.assert_allclose(np.std(errors, axis=0), expected, rtol=0.05)
    np.testing.assert_allclose(np.mean(errors, axis=0), 0, atol=0.002)


def test_before_the_warm_up_is_over_actions_are_uniform() -> None:
    explorer = Ddpg(DdpgConfig(), JUDGE, 0, (), REACH).behaviour()
    explorer.begin(np.random.default_rng(0), REACH)
    actions = np.array([explorer.act(np.zeros(10)) for _ in range(4000)])
    np.testing.assert_allclose(actions.mean(axis=0), [0, 0, 0, 0.5], atol=0.04)
    np.testing.assert_allclose(
        actions.std(axis=0), [3**-0.5] * 3 + [12**-0.5], atol=0.02
    )


def test_running_statistics_are_those_of_everything_at_once() -> None:
    rng = np.random.default_rng(0)
    parts = [rng.normal(3.0, [1.0, 1e-4], size=(n, 2)) for n in (5, 1, 400)]
    statistics = RunningStatistics(2, floor=0.01)
    for part in parts:
        statistics.add(part)
    everything = np.concatenate(parts)
    np.testing.assert_allclose(statistics.mean, everything.mean(axis=0), rtol=1e-6)
    assert statistics.std[0] == pytest.approx(everything[:, 0].std(), rel=1e-6)
    assert statistics.std[1] == pytest.approx(0.01)


@pytest.mark.parametrize(("spread", "far"), [(0.5, False), (0.01, True)])
def test_goals_that_hardly_differ_are_scaled_by_what_is_reached(
    spread: float, far: bool, make_episode: MakeEpisode
) -> None:
    """As those of QuietZone-v0 do along x; in Reach-v0 they differ enough."""
    rng, learner = np.random.default_rng(0), Ddpg(DdpgConfig(), JUDGE, 0, (), REACH)
    seen = []
    for number in range(200):
        episode = make_episode(number)
        episode.states[:, REACH.goal] = 3.0 + spread * rng.normal(size=3)
        learner.observe(episode)
        seen.append(episode.states)
    learner.learn(1)
    states = np.concatenate(seen)
    goals, reached = states[:, REACH.goal], states[:, REACH.achieved]
    scaled_by = np.concatenate([goals, reached]) if far else goals
    normalizer = learner.critic.normalizer
    for found, expected in (
        (normalizer.mean, scaled_by.mean(axis=0)),
        (normalizer.std, scaled_by.std(axis=0)),
    ):
        np.testing.assert_allclose(found[REACH.goal], expected, rtol=1e-5)
    rest = np.delete(states, REACH.goal, axis=1).std(axis=0)
    np.testing.assert_allclose(
        np.delete(normalizer.std.numpy(), REACH.goal), rest, rtol=1e-5
    )


def test_a_joint_actor_cannot_act_for_agents(episodes: list[Episode]) -> None:
    policy = LearnedPolicy("ddpg", taught(Ddpg, KINDS[0][1], episodes).agents, REACH)
    with pytest.raises(UsageError, match="one joint actor"):
        policy.act_agents({"end_effector": np.zeros(9), "balance": np.zeros(7)})


def test_presets_are_table_2_and_ours() -> None:
    paper = preset("ddpg-her", "paper")
    assert (paper.warm_up, paper.capacity, paper.noise) == (5_000, 5_000, 0.1)
    assert (paper.batch_size, paper.discount, paper.target_rate) == (256, 0.95, 0.005)
    assert paper.actor_learning_rate == paper.critic_learning_rate == 1e-3
    assert (paper.episodes, paper.updates_per_episode) == (2_000, 25)
    assert not (paper.layer_norm or paper.clip_targets or paper.action_penalty)
    assert preset("ddpg", "paper").hindsight == 0
    assert preset("maddpg", "paper").others == "replay"
    assert preset("ddpg-her") == DdpgConfig()
    assert preset("maddpg-her") == MaddpgConfig()


@pytest.mark.parametrize(
    "bad",
    [
        {"episodes": 0},
        {"noise": -0.1},
        {"discount": 1.5},
        {"random_share": -1},
        {"hidden": ()},
        {"warm_up": 60_000},
        {"demonstration_share": 2.0},
    ],
)
def test_bad_hyper_parameters_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(UsageError, match=next(iter(bad))):
        replace(DdpgConfig(), **bad)  # type: ignore[arg-type]


@pytest.mark.parametrize(("kind", "config"), KINDS[:2])
def test_actors_and_critic_learn_at_rates_of_their_own(
    kind: type[Ddpg], config: DdpgConfig, episodes: list[Episode]
) -> None:
    """A first step of Adam moves weights by the rate, where there is a gradient."""
    own = {"actor_learning_rate": 1e-2, "critic_learning_rate": 1e-4}
    algorithm = taught(kind, replace(config, **own), episodes)  # type: ignore[arg-type]
    actors = [p for a in algorithm.agents.values() for p in a.actor.parameters()]
    critic = [*algorithm.critic.parameters()]
    before = [[p.detach().clone() for p in part] for part in (actors, critic)]
    algorithm.learn(1)
    for part, then, rate in zip((actors, critic), before, own.values(), strict=True):
        moved = max((p - q).abs().max().item() for p, q in zip(part, then, strict=True))
        assert moved == pytest.approx(rate, rel=0.01)
