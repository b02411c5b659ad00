"""TD3+BC and MATD3+BC: their updates by hand, resumed runs, seeds side by side."""

import io
import shutil
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional

from marl_mm.algorithms import speed
from marl_mm.algorithms.checkpoint import FILE, read_checkpoint, save_seed
from marl_mm.algorithms.config_checks import Precision
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.matd3_bc import Matd3Bc
from marl_mm.algorithms.matd3_bc_config import Matd3BcConfig
from marl_mm.algorithms.networks import perceptron
from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.registry import preset
from marl_mm.algorithms.replay import normalized_actions
from marl_mm.algorithms.runlog import CurvePoint, read_metrics
from marl_mm.algorithms.speed import matrix_products, resolved
from marl_mm.algorithms.td3_bc import Td3Bc
from marl_mm.algorithms.td3_bc_config import Td3BcConfig
from marl_mm.algorithms.train import resume_seeds, train
from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.envs.registry import make_task
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.errors import CheckpointError, DatasetError, UsageError

MakeEpisode = Callable[..., Episode]
JUDGE = make_task("Reach-v0")
SMALL: dict[str, Any] = {"hidden": (16, 16), "batch_size": 32}
PLAIN = {"future": 0.0, "elsewhere": 0.0, "layer_norm": False, "clip_targets": False}
KINDS = (
    (Td3Bc, Td3BcConfig(**SMALL)),
    (Matd3Bc, Matd3BcConfig(**SMALL)),
    (Matd3Bc, Matd3BcConfig(critics="own", others="data", **SMALL)),
)


@pytest.fixture
def arrays(make_episode: MakeEpisode) -> EpisodeArrays:
    return arrays_of([make_episode(i, 3 + i % 4, i % 3 > 0) for i in range(20)], "x")


class Reference:
    """The update written down once more, plainly: one network per critic and actor."""

    def __init__(self, algorithm: Td3Bc, actions: np.ndarray) -> None:
        self.config = config = algorithm.config
        spread = np.maximum(normalized_actions(actions, REACH).std(axis=0), 0.1)
        self.spread = torch.from_numpy(spread) if config.imitation_scaled else 1.0
        self.layouts = algorithm.layouts
        self.mean = algorithm.normalizer.mean
        self.std = algorithm.normalizer.std

        def net(widths: list[int], state: dict[str, torch.Tensor]) -> nn.Sequential:
            layers = perceptron(widths, layer_norm="1.weight" in state)
            network = nn.Sequential(*layers)
            network.load_state_dict(state)
            return network

        hidden = list(config.hidden)
        self.actors = [
            net(
                [len(a.observation), *hidden, len(a.action)],
                algorithm.actors.networks[a.name].member(0),
            )
            for a in self.layouts
        ]
        self.critics = [
            net([14, *hidden, 1], algorithm.critics.networks.member(i))
            for i in range(4 if getattr(config, "critics", "shared") == "own" else 2)
        ]
        self.target_actors, self.target_critics = deepcopy((self.actors, self.critics))
        self.actor_adams = [
            torch.optim.Adam(a.parameters(), config.actor_learning_rate)
            for a in self.actors
        ]
        self.critic_adam = torch.optim.Adam(
            [p for c in self.critics for p in c.parameters()],
            config.critic_learning_rate,
        )
        self.step = 0

    def act(self, actors: list[nn.Sequential], state: torch.Tensor) -> torch.Tensor:
        parts = [
            torch.tanh(actor(state[:, list(a.observation)]))
            for actor, a in zip(actors, self.layouts, strict=True)
        ]
        return torch.cat(parts, dim=1)

    def update(self, batch: OfflineBatch) -> dict[str, torch.Tensor]:
        self.step += 1
        config = self.config
        b = OfflineBatch(*(column[0] for column in batch))
        state = (b.observation - self.mean) / self.std
        next_state = (b.next_observation - self.mean) / self.std
        with torch.no_grad():
            noise = (b.noise * config.target_noise).clamp(
                -config.target_noise_clip, config.target_noise_clip
            )
            action = (self.act(self.target_actors, next_state) + noise).clamp(-1, 1)
            inputs = torch.cat([next_state, action], dim=1)
            targets = []
            for pair in range(len(self.critics) // 2):
                one, two = self.target_critics[2 * pair : 2 * pair + 2]
                value = torch.min(one(inputs), two(inputs))[:, 0]
                target = b.reward + config.discount * (1 - b.terminated) * value
                if config.clip_targets:
                    target = target.clamp(max=10.0)
                targets += [target, target]
        loss = torch.zeros(())
        for critic, target in zip(self.critics, targets, strict=True):
            value = critic(torch.cat([state, b.action], dim=1))[:, 0]
            loss = loss + functional.mse_loss(value, target)
        self.critic_adam.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self.critic_adam.step()
        losses = {"loss/critic": loss.detach()}
        if self.step % config.policy_delay:
            return losses
        weights = torch.tensor(config.imitation_weights)
        weights = weights / weights.sum() * 4
        now = self.act(self.actors, state).detach()
        for number, layout in enumerate(self.layouts):
            own = torch.tanh(self.actors[number](state[:, list(layout.observation)]))
            others = getattr(config, "others", "policy")
            action = (now if others == "policy" else b.action).clone()
            action[:, list(layout.action)] = own
            critic = self.critics[2 * number if len(self.critics) > 2 else 0]
            value = critic(torch.cat([state, action], dim=1))[:, 0]
            data = action.clone()
            data[:, list(layout.action)] = b.action[:, list(layout.action)]
            taken = critic(torch.cat([state, data], dim=1))[:, 0]
            c = config.q_weight
            if config.q_weight_end is not None:
                share = self.step / config.updates
                c = (1 - share) * c + share * config.q_weight_end
            weight = c / value.abs().mean().detach()
            entries = list(layout.action)
            off = (action - b.action) / self.spread
            squares = off[:, entries].square()
            error = (squares * weights[entries]).mean(dim=1)
            imitated = b.imitated > 0
            if config.imitate == "better":
                imitated = imitated & (taken > value)
            if config.imitate == "successful":
                imitated = imitated & (b.successful > 0)
            error = error[imitated].sum() / imitated.sum().clamp_min(1)
            loss = error - weight * value.mean()
            name = "actor" if len(self.layouts) == 1 else layout.name
            losses[f"loss/{name}"] = loss.detach()
            self.actor_adams[number].zero_grad()
            loss.backward()
            self.actor_adams[number].step()
        pairs = [*zip(self.actors, self.target_actors, strict=True)]
        pairs += [*zip(self.critics, self.target_critics, strict=True)]
        with torch.no_grad():
            for network, target in pairs:
                for p, t in zip(network.parameters(), target.parameters(), strict=True):
                    t.copy_(config.target_rate * p + (1 - config.target_rate) * t)
        return losses


@pytest.mark.parametrize(
    "changes",
    [
        PLAIN,
        {"future": 0.3, "elsewhere": 0.3, "imitate": "better", "q_weight": 0.5},
        {"layer_norm": True, "clip_targets": True, "policy_delay": 1},
        {"actor_learning_rate": 2e-3, "policy_delay": 1},
        {
            "imitate": "successful",
            "imitation_weights": (2.0, 1.0, 0.5, 0.1),
            "imitation_scaled": False,
            "q_weight_end": 0.1,
        },
        # By so much that what targets do would show.
        {**PLAIN, "target_rate": 0.5, "target_noise": 1.0, "policy_delay": 1},
    ],
)
@pytest.mark.parametrize(("kind", "config"), KINDS)
def test_updates_are_those_by_hand(
    arrays: EpisodeArrays,
    kind: type[Td3Bc],
    config: Td3BcConfig,
    changes: dict[str, object],
) -> None:
    config = replace(config, **changes)  # type: ignore[arg-type]
    algorithm = kind(config, arrays, JUDGE, [3])
    reference = Reference(algorithm, arrays.actions)
    twin = kind(config, arrays, JUDGE, [3])._batches
    for _ in range(4):
        found, expected = algorithm.update(), reference.update(twin.next())
        for name, loss in expected.items():
            torch.testing.assert_close(found[name][0], loss, atol=1e-6, rtol=1e-6)
    pairs = (
        (reference.critics, algorithm.critics.networks),
        (reference.target_critics, algorithm._target_critics.networks),
    )
    for theirs, ours in pairs:
        for i, critic in enumerate(theirs):
            equal(ours.member(i), critic.state_dict())
    for number, layout in enumerate(algorithm.layouts):
        ours = algorithm.actors.networks[layout.name]
        equal(ours.member(0), reference.actors[number].state_dict())
        ours = algorithm._target_actors.networks[layout.name]
        equal(ours.member(0), reference.target_actors[number].state_dict())


def equal(ours: dict[str, torch.Tensor], theirs: dict[str, torch.Tensor]) -> None:
    for name, value in theirs.items():
        torch.testing.assert_close(ours[name], value, atol=1e-6, rtol=0)


@pytest.mark.parametrize(("kind", "config"), KINDS)
def test_a_resumed_run_is_bit_equal(
    arrays: EpisodeArrays, kind: type[Td3Bc], config: Td3BcConfig
) -> None:
    """Stopped within the batches that were drawn together."""
    config = replace(config, future=0.4, elsewhere=0.2)
    whole, first = (kind(config, arrays, JUDGE, [5]) for _ in range(2))
    for _ in range(70):
        whole.update()
    for _ in range(47):
        first.update()
    file = io.BytesIO()
    torch.save(first.state(0), file)
    file.seek(0)
    again = kind(config, arrays, JUDGE, [5])
    again.load_states([torch.load(file, weights_only=True)])
    for _ in range(23):
        again.update()
    assert again.critics.networks.flat.equal(whole.critics.networks.flat)
    for name, actor in whole.actors.networks.items():
        assert again.actors.networks[name].flat.equal(actor.flat)


@pytest.mark.parametrize(("kind", "config"), KINDS)
def test_seeds_side_by_side_are_those_alone(
    arrays: EpisodeArrays, kind: type[Td3Bc], config: Td3BcConfig
) -> None:
    alone, together = (kind(config, arrays, JUDGE, s) for s in ([7], [6, 7, 8]))
    for _ in range(20):
        one, three = alone.update(), together.update()
        for name, value in one.items():
            torch.testing.assert_close(three[name][1:2], value, atol=1e-5, rtol=1e-4)
    for name, actor in alone.actors.networks.items():
        for key, value in actor.member(0).items():
            expected = together.actors.networks[name].member(1)[key]
            torch.testing.assert_close(value, expected, atol=1e-6, rtol=1e-4)


def test_an_agents_gradient_does_not_reach_what_it_cannot_see(
    arrays: EpisodeArrays,
) -> None:
    """What an agent does depends on its own observation alone."""
    algorithm = Matd3Bc(KINDS[1][1], arrays, JUDGE, [0])
    for _ in range(10):
        algorithm.update()
    state = torch.randn(1, 5, 10, requires_grad=True)
    action = algorithm.actors.joint(state)
    for agent in REACH.agents:
        (slope,) = torch.autograd.grad(
            action[..., list(agent.action)].sum(), state, retain_graph=True
        )
        unseen = sorted(set(range(10)) - set(agent.observation))
        assert (slope[..., unseen] == 0).all()
        assert (slope[..., list(agent.observation)] != 0).any()


def test_goals_are_exchanged_as_by_hand(arrays: EpisodeArrays) -> None:
    """Each transition of a batch is one of the data, by one of three kinds of goals."""
    config = Td3BcConfig(future=0.4, elsewhere=0.3, batch_size=500, hidden=(4,))
    batch = Td3Bc(config, arrays, JUDGE, [0])._batches.next()
    joint_states = arrays.states.astype(np.float32)
    first = np.flatnonzero(~arrays.is_last_state())
    owner = np.cumsum(arrays.is_first_state()) - 1
    goals = {tuple(state[7:]) for state in joint_states}
    kinds = {"own": 0, "future": 0, "elsewhere": 0}
    for i in range(500):
        state, after = batch.observation[0, i].numpy(), batch.next_observation[0, i]
        (row,) = [r for r in first if (joint_states[r, :7] == state[:7]).all()]
        np.testing.assert_array_equal(joint_states[row + 1, :7], after[:7].numpy())
        np.testing.assert_array_equal(after[7:].numpy(), state[7:])
        goal = state[7:]
        later = joint_states[row + 1 :][owner[row + 1 :] == owner[row]]
        if not batch.imitated[0, i]:
            kind = "elsewhere"
            assert tuple(goal) in goals
        elif (goal == joint_states[row, 7:]).all():
            kind = "own"
        else:
            kind = "future"
            assert (later[:, :3] == goal).all(axis=1).any()
        kinds[kind] += 1
        step = np.flatnonzero(first == row)
        costs = {k: arrays.info[k][step] for k in ("d_mm", "d_mp", "base_jerk_rms")}
        hand = arrays.states[row + 1 : row + 2, :3]
        exact = goal.astype(float)[None]
        if kind == "own":
            expected = arrays.rewards[step], arrays.terminated[step]
        else:
            failed = arrays.failed()[step]
            expected = JUDGE.judge(hand, exact, {**costs, "failed": failed})
        np.testing.assert_allclose(batch.reward[0, i], expected[0][0], atol=1e-5)
        assert batch.terminated[0, i] == expected[1][0]
    assert abs(kinds["elsewhere"] - 150) < 50 and abs(kinds["future"] - 200) < 60


@pytest.mark.parametrize("name", ["states", "actions", "rewards"])
def test_a_nan_in_the_data_is_named(arrays: EpisodeArrays, name: str) -> None:
    values = getattr(arrays, name)
    values[7] = np.inf
    with pytest.raises(DatasetError, match=rf"{name} are not .* in row 7:"):
        Td3Bc(Td3BcConfig(**SMALL), arrays, JUDGE, [0])


def test_unknown_costs_forbid_other_goals(arrays: EpisodeArrays) -> None:
    arrays.info["d_mp"][4] = np.nan
    own = Td3BcConfig(future=0, elsewhere=0, **SMALL)
    Td3Bc(own, arrays, JUDGE, [0]).update()
    with pytest.raises(UsageError, match="`future` to 0, and `elsewhere` to 0"):
        Td3Bc(replace(own, future=0.2), arrays, JUDGE, [0])


def test_episodes_that_failed_are_marked(arrays: EpisodeArrays) -> None:
    batch = Td3Bc(Td3BcConfig(**SMALL), arrays, JUDGE, [0])._batches.next()
    owners = arrays.step_episode()
    taken = normalized_actions(arrays.actions, REACH)
    for action, successful in zip(batch.action[0], batch.successful[0], strict=True):
        (row,) = np.flatnonzero((taken == action.numpy()).all(axis=1))
        assert successful.item() == (owners[row] % 3 > 0)


def test_what_hardly_varies_is_imitated_most(arrays: EpisodeArrays) -> None:
    """A hundred times as much as what varies over its whole range, and no more."""
    actions = arrays.actions.copy()
    actions[:, 0] = np.where(np.arange(len(actions)) % 2, REACH.high[0], REACH.low[0])
    actions[:, 3] = 0.7
    known = replace(arrays, actions=actions)
    weights = Td3Bc(Td3BcConfig(**SMALL), known, JUDGE, [0])._imitation.weights
    assert weights[3] / weights[0] == pytest.approx(100.0, rel=1e-2)
    assert weights.argmax() == 3


def test_the_slope_that_is_logged_by_hand(arrays: EpisodeArrays) -> None:
    """Towards the goal along x less away from it, by the first critic."""
    algorithm = Td3Bc(Td3BcConfig(**SMALL), arrays, JUDGE, [0])
    rows = np.flatnonzero(~arrays.is_last_state())
    state = torch.tensor(arrays.states[rows], dtype=torch.float32)
    low, high = torch.tensor(REACH.low), torch.tensor(REACH.high)
    action = 2 * (torch.tensor(arrays.actions) - low) / (high - low) - 1
    there, back = action.clone(), action.clone()
    there[:, 0] = torch.sign(state[:, 7] - state[:, 0])
    back[:, 0] = -there[:, 0]
    inputs = algorithm.normalizer(state)[None]
    first = algorithm.critics.first
    expected = (first(inputs, there[None]) - first(inputs, back[None])).mean()
    found = algorithm.diagnose()["q/slope"]
    torch.testing.assert_close(found[0], expected.detach(), atol=1e-5, rtol=1e-4)


def test_shares_beyond_one_are_refused() -> None:
    with pytest.raises(UsageError, match="together"):
        Td3BcConfig(future=0.7, elsewhere=0.6)
    with pytest.raises(UsageError, match="q_weight is nan"):
        Td3BcConfig(q_weight=float("nan"))
    with pytest.raises(UsageError, match="q_weight_end is -1"):
        Td3BcConfig(q_weight_end=-1.0)
    with pytest.raises(UsageError, match=r"imitation_weights .* delta_x"):
        Td3BcConfig(imitation_weights=(1.0, 1.0, 1.0))


def test_a_weight_of_no_action_is_refused(arrays: EpisodeArrays) -> None:
    layout = arrays.layout
    hand = replace(layout.team[0], sets=("left", *layout.team[0].sets[1:]))
    action = (replace(layout.action[0], name="left"), *layout.action[1:])
    layout = replace(layout, action=action, team=(hand, *layout.team[1:]))
    arrays = replace(arrays, layout=layout)
    config = Td3BcConfig(imitation_weights=(2.0, 1.0, 1.0, 1.0))
    with pytest.raises(UsageError, match="a weight for delta_x, expected 1"):
        Td3Bc(config, arrays, JUDGE, [0])


def test_the_joint_actor_sees_everything(arrays: EpisodeArrays) -> None:
    config = Matd3BcConfig(**SMALL)
    assert Td3Bc(config, arrays, JUDGE, [0]).layouts == (REACH.joint,)
    assert Matd3Bc(config, arrays, JUDGE, [0]).layouts == REACH.agents


@pytest.mark.parametrize(("kind", "config"), KINDS)
def test_several_seeds_in_one_process_leave_runs_of_their_own(
    arrays: EpisodeArrays, tmp_path: Path, kind: type[Td3Bc], config: Td3BcConfig
) -> None:
    """As on a GPU; and go on together, or refuse to."""
    config = replace(config, updates=200)
    runs = [tmp_path / str(seed) for seed in (4, 5)]
    for run in runs:
        run.mkdir()
    whole = kind(config, arrays, JUDGE, [4, 5])
    train(whole, runs, lambda policy: {}, 100)
    first, second = (read_metrics(run) for run in runs)
    assert [row["step"] for row in first] == [0, 100, 200]
    assert first[1]["loss/critic"] != second[1]["loss/critic"]
    cut = kind(replace(config, updates=100), arrays, JUDGE, [4, 5])
    train(cut, runs, lambda policy: {}, 100)
    states = [read_checkpoint(run)["state"] for run in runs]
    again = kind(config, arrays, JUDGE, [4, 5])
    again.load_states(states)
    train(again, runs, lambda policy: {}, 100)
    for number in (0, 1):
        for name, one in again.agents(number).items():
            other = whole.agents(number)[name].actor.state_dict()
            for key, value in one.actor.state_dict().items():
                assert torch.equal(value, other[key])
    early = kind(config, arrays, JUDGE, [4, 5])
    early.update()
    save_seed(runs[1] / FILE, early, 1)
    with pytest.raises(CheckpointError, match="stand at updates 200, 1:"):
        resume_seeds(early, runs)


def test_precision_is_of_updates_only(arrays: EpisodeArrays, tmp_path: Path) -> None:
    """Whoever evaluates meanwhile, or goes on after a run that failed, has torch's."""
    seen: list[str] = []
    losses: list[float] = []

    def trained(precision: Precision, spoilt: bool = False) -> list[float]:
        config = Td3BcConfig(updates=20, precision=precision, **SMALL)
        algorithm = Td3Bc(config, arrays, JUDGE, [0])
        update = algorithm.update
        losses.clear()

        def noted() -> dict[str, torch.Tensor]:
            seen.append(torch.get_float32_matmul_precision())
            if spoilt:
                raise KeyboardInterrupt
            measured = update()
            losses.append(measured["loss/critic"].item())
            return measured

        algorithm.update = noted  # type: ignore[method-assign]

        def evaluate(policy: LearnedPolicy) -> CurvePoint:
            assert torch.get_float32_matmul_precision() == "highest"
            return {}

        shutil.rmtree(tmp_path)
        tmp_path.mkdir()
        train(algorithm, [tmp_path], evaluate, 10)
        return list(losses)

    exact, rounded = trained("highest"), trained("medium")
    assert seen == ["highest"] * 20 + ["medium"] * 20
    if resolved("auto") == "medium":  # parity is kept
        np.testing.assert_allclose(rounded, exact, rtol=1e-4)
    with pytest.raises(KeyboardInterrupt):
        trained("medium", spoilt=True)
    assert torch.get_float32_matmul_precision() == "highest"


@pytest.mark.parametrize("exact", [True, False])
def test_auto_is_medium_only_where_that_is_exact(
    exact: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Products that are rounded to bfloat16 are told from those that are not."""
    speed._medium_is_exact.cache_clear()
    multiply = torch.baddbmm

    def maybe_rounded(*factors: torch.Tensor) -> torch.Tensor:
        medium = torch.get_float32_matmul_precision() == "medium"
        with speed._torch_precision("highest"):
            if medium and not exact:
                return multiply(*(one.bfloat16().float() for one in factors))
            return multiply(*factors)

    monkeypatch.setattr(torch, "baddbmm", maybe_rounded)
    with matrix_products("auto"):
        chosen = torch.get_float32_matmul_precision()
    assert chosen == ("medium" if exact else "highest")
    speed._medium_is_exact.cache_clear()


def test_the_papers_preset_is_the_papers() -> None:
    """Table 3; Fujimoto & Gu 2021 and Fujimoto 2018 where it is silent."""
    config = preset("td3-bc", "paper")
    assert isinstance(config, Td3BcConfig)
    assert (config.updates, config.batch_size, config.discount) == (100_000, 256, 0.95)
    assert config.actor_learning_rate == config.critic_learning_rate == 5e-4
    assert (config.target_rate, config.target_noise) == (0.005, 0.1)
    assert (config.q_weight, config.q_weight_end, config.policy_delay) == (2.5, None, 2)
    assert not (config.clip_targets or config.layer_norm)
    assert config.future == config.elsewhere == 0.0 and config.imitate == "all"
    multi = preset("matd3-bc", "paper")
    assert isinstance(multi, Matd3BcConfig)
    assert (multi.critics, multi.others) == ("own", "data")
    cloning = preset("mabc", "paper")
    assert isinstance(cloning, MabcConfig)
    assert (cloning.updates, cloning.learning_rate) == (100_000, 5e-4)
    assert cloning.future == 0.0
