"""Imitation of demonstrations in online learning: where, of whom, and when not."""

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from marl_mm.algorithms.actors import joint_action
from marl_mm.algorithms.checkpoint import FILE, checkpoint
from marl_mm.algorithms.ddpg import Ddpg
from marl_mm.algorithms.ddpg_config import DdpgConfig
from marl_mm.algorithms.maddpg import Maddpg
from marl_mm.algorithms.maddpg_config import MaddpgConfig
from marl_mm.algorithms.replay import Batch
from marl_mm.algorithms.train import resume
from marl_mm.declared import as_record
from marl_mm.envs.registry import make_task
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.errors import OtherConfigError, UsageError
from marl_mm.runs.train import train

MakeEpisode = Callable[..., Episode]
JUDGE = make_task()
SMALL = {"hidden": (16, 16), "batch_size": 32, "warm_up": 0, "capacity": 2000}
KINDS = (
    (Ddpg, DdpgConfig(**SMALL)),  # type: ignore[arg-type]
    (Maddpg, MaddpgConfig(**SMALL)),  # type: ignore[arg-type]
    (Maddpg, MaddpgConfig(others="replay", **SMALL)),  # type: ignore[arg-type]
)


@pytest.fixture
def shown(make_episode: MakeEpisode) -> list[Episode]:
    """Demonstrations in which every action is the same."""
    episodes = [make_episode(100 + i, steps=10) for i in range(5)]
    action = np.array([0.9, -0.9, 0.5, 0.1], np.float32)
    return [replace(e, actions=np.tile(action, (10, 1))) for e in episodes]


def taught(
    kind: type[Ddpg], config: DdpgConfig, shown: list[Episode], make: MakeEpisode
) -> Ddpg:
    algorithm = kind(config, JUDGE, 0, shown, REACH)
    for i in range(5):
        algorithm.observe(make(i, steps=10))
    return algorithm


def weights(algorithm: Ddpg) -> bytes:
    networks = [algorithm.critic, *(a.actor for a in algorithm.agents.values())]
    parts = [p.detach().numpy().tobytes() for n in networks for p in n.parameters()]
    return b"".join(parts)


def error(algorithm: Ddpg, shown: list[Episode]) -> float:
    """Mean square error at the demonstrated actions."""
    states = torch.from_numpy(np.stack([e.states[0] for e in shown])).float()
    wanted = torch.tensor([0.9, -0.9, 0.5, -0.8])  # alpha of 0.1 is -0.8 in [-1, 1]
    with torch.no_grad():
        off = joint_action(algorithm.agents, states) - wanted
    return float(off.square().mean())


class Divided(torch.nn.Module):
    """A critic that wants the first action high where x > 0, and low elsewhere."""

    def forward(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return state[:, 0].sign() * action[:, 0]


@pytest.mark.parametrize(("kind", "config"), KINDS)
def test_only_what_the_critic_prefers_is_imitated(
    kind: type[Ddpg],
    config: DdpgConfig,
    shown: list[Episode],
    make_episode: MakeEpisode,
) -> None:
    """By hand: the demonstrated action is 1, above any of an actor's."""
    config = replace(config, imitation_weight=3.0, demonstration_share=0.5)
    algorithm = taught(kind, config, shown, make_episode)
    algorithm.critic = Divided()  # type: ignore[assignment]
    state = torch.from_numpy(np.random.default_rng(0).normal(size=(32, 10))).float()
    wanted = torch.tensor([1.0, -0.5, 0.5, 0.0]).expand(32, 4)
    none = torch.zeros(32)
    loss = algorithm._imitation_loss(Batch(state, wanted, none, state, none))
    acted = joint_action(algorithm.agents, state)
    prefers = torch.arange(32) >= 16  # demonstrations are the second half
    prefers &= state[:, 0] > 0
    assert 0 < prefers.sum() < 16
    by_hand = 3 * (acted - wanted)[prefers].square().mean(dim=-1).sum() / 16
    torch.testing.assert_close(loss, by_hand)
    for agent in algorithm.agents.values():  # and it moves the whole team
        parameters = list(agent.actor.parameters())
        gradients = torch.autograd.grad(loss, parameters, retain_graph=True)
        assert all((gradient != 0).any() for gradient in gradients)


@pytest.mark.parametrize(("kind", "config"), KINDS)
def test_actors_come_nearer_to_demonstrations_with_it(
    kind: type[Ddpg],
    config: DdpgConfig,
    shown: list[Episode],
    make_episode: MakeEpisode,
) -> None:
    errors = []
    for weight in (0.0, 100.0):
        imitating = replace(config, imitation_weight=weight, action_penalty=0.0)
        algorithm = taught(kind, imitating, shown, make_episode)
        algorithm.learn(100)
        errors.append(error(algorithm, shown))
    assert errors[1] < errors[0] / 2


@pytest.mark.parametrize(("kind", "config"), KINDS)
def test_without_weight_or_demonstrations_no_bit_is_another(
    kind: type[Ddpg],
    config: DdpgConfig,
    shown: list[Episode],
    make_episode: MakeEpisode,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    heavy = replace(config, imitation_weight=5.0)
    learnt = {}
    for name, episodes in (("some", shown), ("none", [])):
        for weight, settings in ((0, config), (5, heavy)):
            algorithm = taught(kind, settings, episodes, make_episode)
            algorithm.learn(3)
            learnt[name, weight] = weights(algorithm)
    assert learnt["none", 0] == learnt["none", 5]
    assert learnt["some", 0] != learnt["some", 5]
    monkeypatch.delattr(Ddpg, "_imitation_loss")  # what it was before there was one
    algorithm = taught(kind, config, shown, make_episode)
    algorithm.learn(3)
    assert learnt["some", 0] == weights(algorithm)


def test_records_tell_of_it_only_where_it_is_used(
    shown: list[Episode], make_episode: MakeEpisode, tmp_path: Path
) -> None:
    """Checkpoints that lack it go on without; others go on with the same only."""
    config = KINDS[0][1]
    heavy = replace(config, imitation_weight=5.0)
    assert "imitation_weight" not in as_record(config)
    assert as_record(heavy) == asdict(heavy)
    algorithm = taught(Ddpg, heavy, shown, make_episode)
    (tmp_path / FILE).write_bytes(checkpoint(algorithm))
    with pytest.raises(OtherConfigError, match=r"imitation_weight = 5.0 \(now 0.0\)"):
        resume(taught(Ddpg, config, shown, make_episode), tmp_path)
    old = torch.load(tmp_path / FILE, weights_only=True)
    del old["config"]["imitation_weight"]
    torch.save(old, tmp_path / FILE)
    resume(taught(Ddpg, config, shown, make_episode), tmp_path)
    with pytest.raises(OtherConfigError, match=r"imitation_weight = 0.0 \(now 5.0\)"):
        resume(taught(Ddpg, heavy, shown, make_episode), tmp_path)


def test_a_weight_without_demonstrations_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="there are no `demonstrations`"):
        train("ddpg-her", imitation_weight=1.0, out=tmp_path / "run")
    with pytest.raises(UsageError, match=r"imitation_weight is -1\.0, expected"):
        train("ddpg-her", imitation_weight=-1.0, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
