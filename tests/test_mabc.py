"""MABC: the update by hand, decentralised actors, self-sufficient checkpoints."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from marl_mm.algorithms.checkpoint import FILE, read_checkpoint, save_checkpoint
from marl_mm.algorithms.mabc import Mabc, MabcConfig
from marl_mm.algorithms.networks import ActionScale, Normalizer
from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.algorithms.runlog import read_metrics
from marl_mm.algorithms.train import resume, train
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.dataset import Dataset, Transitions
from marl_mm.datasets.location import locate
from marl_mm.envs.parallel import split_state
from marl_mm.episode import Episode
from marl_mm.errors import CheckpointError, UsageError

MakeEpisode = Callable[..., Episode]
ID = "marl_mm/reach/x-v0"
CONFIG = MabcConfig(updates=300, batch_size=32, hidden=(16, 16))


def no_evaluation(policy: LearnedPolicy) -> dict[str, float]:
    return {}


@pytest.fixture
def data(make_episode: MakeEpisode) -> dict[str, Transitions]:
    episodes = [make_episode(i, steps=20) for i in range(10)]
    return Dataset(locate(ID), {}, arrays_of(episodes, ID)).agents()


def weights(algorithm: Mabc) -> list[torch.Tensor]:
    return [p for a in algorithm.agents.values() for p in a.actor.state_dict().values()]


def test_one_update_equals_the_hand_written_one(data: dict[str, Transitions]) -> None:
    """Batch by the seed's generator, MSE in [-1, 1] coordinates, Adam's first step."""
    algorithm = Mabc(CONFIG, data, seed=4)
    agent = algorithm.agents["balance"]
    part = data["balance"]
    index = torch.randint(
        len(part), (32,), generator=torch.Generator().manual_seed(4)
    ).numpy()
    observation = torch.tensor(part.observation, dtype=torch.float32)
    mean, std = observation.mean(0), observation.std(0, correction=0)
    inputs = (observation[index] - mean) / std
    wanted = torch.tensor(2 * part.action[index] - 1)  # alpha from [0, 1]
    linear = [m for m in agent.actor.layers if isinstance(m, torch.nn.Linear)]
    before = [
        p.detach().clone().requires_grad_() for m in linear for p in (m.weight, m.bias)
    ]
    hidden = torch.relu(inputs @ before[0].T + before[1])
    hidden = torch.relu(hidden @ before[2].T + before[3])
    loss = ((torch.tanh(hidden @ before[4].T + before[5]) - wanted) ** 2).mean()
    gradients = torch.autograd.grad(loss, before)
    metrics = algorithm.update()
    assert metrics["loss/balance"] == pytest.approx(loss.item(), rel=1e-6)
    after = [p for m in linear for p in (m.weight, m.bias)]
    for old, gradient, new in zip(before, gradients, after, strict=True):
        # Adam's first step is the sign of the gradient, softened by its epsilon.
        expected = old - CONFIG.learning_rate * gradient / (gradient.abs() + 1e-8)
        torch.testing.assert_close(new, expected, atol=1e-6, rtol=0)


def test_actors_learn_what_can_be_learnt(data: dict[str, Transitions]) -> None:
    """Actions that are a function of the observation are cloned."""

    def learnable_part(part: Transitions) -> Transitions:
        seen = part.observation[:, : part.action.shape[1]]
        return replace(part, action=(np.tanh(seen) + 1) / 2)

    learnable = {name: learnable_part(part) for name, part in data.items()}
    algorithm = Mabc(replace(CONFIG, learning_rate=3e-3), learnable, seed=0)
    for _ in range(1500):
        last = algorithm.update()
    assert max(last.values()) < 0.02


def test_actors_are_decentralised(data: dict[str, Transitions]) -> None:
    """What an agent does not observe cannot change what it does."""
    algorithm = Mabc(CONFIG, data, seed=0)
    policy = LearnedPolicy("mabc", algorithm.agents)
    state = np.random.default_rng(0).normal(size=10)
    action = policy.act(state)
    other_goal, other_mode = state.copy(), state.copy()
    other_goal[7:] += 1.0
    other_mode[6] += 1.0
    assert policy.act(other_goal)[3] == action[3]
    assert (policy.act(other_goal)[:3] != action[:3]).any()
    np.testing.assert_array_equal(policy.act(other_mode)[:3], action[:3])
    assert policy.act(other_mode)[3] != action[3]


def test_every_way_to_ask_a_policy_gives_one_answer(
    data: dict[str, Transitions],
) -> None:
    policy = LearnedPolicy("mabc", Mabc(CONFIG, data, seed=0).agents)
    state = np.random.default_rng(1).normal(size=10)
    joint = policy.act(state)
    goal = {"observation": state[:7], "achieved_goal": state[:3]}
    np.testing.assert_array_equal(
        policy.act({**goal, "desired_goal": state[7:]}), joint
    )
    agents = policy.act_agents(split_state(state))
    np.testing.assert_array_equal(np.concatenate(list(agents.values())), joint)
    assert (joint >= [-1, -1, -1, 0]).all() and (joint <= 1).all()
    with pytest.raises(UsageError, match=r"shape \(9,\)"):
        policy.act(state[:9])


def test_a_loaded_policy_acts_equally_without_the_dataset(
    data: dict[str, Transitions], tmp_path: Path
) -> None:
    algorithm = Mabc(CONFIG, data, seed=0)
    for _ in range(5):
        algorithm.update()
    save_checkpoint(tmp_path / FILE, algorithm)
    policy = LearnedPolicy("mabc", algorithm.agents)
    for loaded in (load_policy(tmp_path), load_policy(tmp_path / FILE)):
        for state in np.random.default_rng(2).normal(size=(20, 10)):
            np.testing.assert_array_equal(loaded.act(state), policy.act(state))


def test_same_seed_same_weights_and_other_seed_others(
    data: dict[str, Transitions],
) -> None:
    runs = [Mabc(CONFIG, data, seed) for seed in (1, 1, 2)]
    for algorithm in runs:
        torch.rand(3)  # the global generator must not matter
        for _ in range(10):
            algorithm.update()
    pairs = zip(weights(runs[0]), weights(runs[1]), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    assert not torch.equal(weights(runs[0])[2], weights(runs[2])[2])


def test_resume_continues_bit_equally(
    data: dict[str, Transitions], tmp_path: Path
) -> None:
    """Stopped in the middle by a real KeyboardInterrupt, then resumed."""
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    whole.mkdir()
    stopped.mkdir()
    reference = Mabc(CONFIG, data, seed=3)
    train(reference, whole, no_evaluation, 100)

    def interrupt(policy: LearnedPolicy) -> dict[str, float]:
        if cut.step == 200:
            raise KeyboardInterrupt
        return {}

    cut = Mabc(CONFIG, data, seed=3)
    with pytest.raises(KeyboardInterrupt, match="--resume"):
        train(cut, stopped, interrupt, 100)
    again = Mabc(CONFIG, data, seed=3)
    resume(again, stopped)
    assert again.step == 100  # the last checkpoint
    train(again, stopped, no_evaluation, 100)
    pairs = zip(weights(reference), weights(again), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    assert read_metrics(whole) == read_metrics(stopped)
    assert (whole / "metrics.jsonl").read_bytes() == (
        stopped / "metrics.jsonl"
    ).read_bytes()


def test_evaluation_comes_when_it_was_asked_for(
    data: dict[str, Transitions], tmp_path: Path
) -> None:
    """At 0, every 130 and the end, whatever the rhythm of the log is."""
    train(Mabc(CONFIG, data, 0), tmp_path, lambda policy: {"success/all": 0.5}, 130)
    rows = read_metrics(tmp_path)
    measured = [row["step"] for row in rows if "success/all" in row]
    assert measured == [0, 130, 260, 300]
    assert [row["step"] for row in rows] == [0, 100, 130, 200, 260, 300]


def test_resume_refuses_another_config(
    data: dict[str, Transitions], tmp_path: Path
) -> None:
    train(Mabc(CONFIG, data, seed=0), tmp_path, no_evaluation, 1000)
    other = Mabc(replace(CONFIG, learning_rate=1e-3), data, seed=0)
    with pytest.raises(UsageError, match=r"learning_rate = 0\.0005 \(now 0\.001\)"):
        resume(other, tmp_path)


def test_a_checkpoint_of_another_algorithm_is_named(
    data: dict[str, Transitions], tmp_path: Path
) -> None:
    save_checkpoint(tmp_path / FILE, Mabc(CONFIG, data, seed=0))
    checkpoint = torch.load(tmp_path / FILE, weights_only=True)
    torch.save({**checkpoint, "algorithm": "td3-bc"}, tmp_path / FILE)
    with pytest.raises(CheckpointError, match="'td3-bc', expected 'mabc'"):
        load_policy(tmp_path)


def test_damaged_and_missing_checkpoints_are_named(
    data: dict[str, Transitions], tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match="no checkpoint at"):
        load_policy(tmp_path)
    (tmp_path / FILE).write_bytes(b"")
    with pytest.raises(CheckpointError, match="damaged"):
        load_policy(tmp_path)
    save_checkpoint(tmp_path / FILE, Mabc(CONFIG, data, seed=0))
    whole = torch.load(tmp_path / FILE, weights_only=True)
    content = (tmp_path / FILE).read_bytes()
    (tmp_path / FILE).write_bytes(content[: len(content) // 2])
    with pytest.raises(CheckpointError, match="damaged"):
        load_policy(tmp_path)
    torch.save([1, 2], tmp_path / FILE)
    with pytest.raises(CheckpointError, match="is not a"):
        read_checkpoint(tmp_path)
    swapped = {**whole["layout"], "agents": whole["layout"]["agents"][::-1]}
    for broken, message in (
        ({"layout": swapped}, "another agent layout"),
        ({"config": {**whole["config"], "hidden": [8, 8]}}, "damaged"),
        ({"state": {}}, "damaged"),
    ):
        torch.save({**whole, **broken}, tmp_path / FILE)
        with pytest.raises(CheckpointError, match=message):
            load_policy(tmp_path)
    del whole["state"]
    torch.save(whole, tmp_path / FILE)
    with pytest.raises(CheckpointError, match="lacks state"):
        load_policy(tmp_path)


@pytest.mark.parametrize(
    "bad", [{"updates": 0}, {"batch_size": -1}, {"learning_rate": 0.0}, {"hidden": ()}]
)
def test_bad_hyper_parameters_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(UsageError, match=next(iter(bad))):
        replace(MabcConfig(), **bad)  # type: ignore[arg-type]


def test_normalizer_by_hand_and_its_floor() -> None:
    data = torch.tensor([[1.0, 5.0], [3.0, 5.0]])
    normalizer = Normalizer.of(data, floor=0.01)
    result = normalizer(torch.tensor([[4.0, 5.1]]))
    torch.testing.assert_close(result, torch.tensor([[2.0, 10.0]]), atol=1e-4, rtol=0)


def test_action_scale_is_its_own_inverse() -> None:
    scale = ActionScale(torch.tensor([-1.0, 0.0]), torch.tensor([1.0, 1.0]))
    action = torch.tensor([[0.3, 0.25]])
    torch.testing.assert_close(scale.normalize(action), torch.tensor([[0.3, -0.5]]))
    torch.testing.assert_close(scale.denormalize(scale.normalize(action)), action)
