"""MABC: the update by hand, decentralised actors, self-sufficient checkpoints."""

import errno
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from marl_mm.algorithms.checkpoint import BEST, FILE, read_checkpoint, save_seed
from marl_mm.algorithms.mabc import Mabc
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.networks import ActionScale, Normalizer
from marl_mm.algorithms.policy import LearnedPolicy, load_policy
from marl_mm.algorithms.replay import normalized_actions
from marl_mm.algorithms.runlog import CurvePoint, read_metrics
from marl_mm.algorithms.train import resume_seeds, train
from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.envs.parallel import split_state
from marl_mm.envs.registry import make_task
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.errors import CheckpointError, DivergedError, UsageError
from marl_mm.files import append

MakeEpisode = Callable[..., Episode]
JUDGE = make_task()
BALANCE = REACH.agents[1]
CONFIG = MabcConfig(updates=300, batch_size=32, hidden=(16, 16))


def no_evaluation(policy: LearnedPolicy) -> CurvePoint:
    return {}


@pytest.fixture
def arrays(make_episode: MakeEpisode) -> EpisodeArrays:
    return arrays_of([make_episode(i, steps=20) for i in range(10)], "x")


def weights(algorithm: Mabc) -> list[torch.Tensor]:
    agents = algorithm.agents(0).values()
    return [p for agent in agents for p in agent.actor.state_dict().values()]


@pytest.mark.parametrize("future", [0.0, 0.5])
def test_updates_are_those_by_hand(arrays: EpisodeArrays, future: float) -> None:
    """MSE in [-1, 1] coordinates, each agent on its own entries, Adam."""
    config = replace(CONFIG, future=future)
    algorithm = Mabc(config, arrays, JUDGE, [4])
    batches = Mabc(config, arrays, JUDGE, [4])._batches
    states = torch.tensor(arrays.states, dtype=torch.float32)
    mean, std = states.mean(0), states.std(0, correction=0).clamp_min(0.01)
    names = [f"{layer}.{kind}" for layer in (0, 2, 4) for kind in ("weight", "bias")]
    members = {
        agent.name: algorithm.actors.networks[agent.name].member
        for agent in REACH.agents
    }
    weights = {
        name: [member(0)[part].requires_grad_() for part in names]
        for name, member in members.items()
    }
    learners = {
        name: torch.optim.Adam(own, config.learning_rate)
        for name, own in weights.items()
    }
    for _ in range(4):
        batch, losses = batches.next(), algorithm.update()
        for agent in REACH.agents:
            w1, b1, w2, b2, w3, b3 = weights[agent.name]
            own = ((batch.observation[0] - mean) / std)[:, agent.observation]
            hidden = torch.relu(torch.relu(own @ w1.T + b1) @ w2.T + b2)
            wanted = batch.action[0][:, list(agent.action)]
            loss = ((torch.tanh(hidden @ w3.T + b3) - wanted) ** 2).mean()
            learners[agent.name].zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            learners[agent.name].step()
            assert abs(losses[f"loss/{agent.name}"].item() - loss.item()) < 1e-6
    for name, member in members.items():
        for part, expected in zip(names, weights[name], strict=True):
            torch.testing.assert_close(member(0)[part], expected, atol=1e-6, rtol=0)


def test_actors_learn_what_can_be_learnt(arrays: EpisodeArrays) -> None:
    """Actions that are a function of the observation are cloned."""
    states = arrays.states[~arrays.is_last_state()]
    seen = np.tanh(states[:, [0, 1, 2, BALANCE.observation[0]]])
    seen[:, 3] = (seen[:, 3] + 1) / 2
    learnable = replace(arrays, actions=seen.astype(np.float32))
    config = replace(CONFIG, learning_rate=3e-3)
    algorithm = Mabc(config, learnable, JUDGE, [0])
    for _ in range(1500):
        last = algorithm.update()
    assert max(value.item() for value in last.values()) < 0.02
    assert algorithm.diagnose()["imitation/delta_x"].item() < 0.02


def test_actors_are_decentralised(arrays: EpisodeArrays) -> None:
    """What an agent does not observe cannot change what it does."""
    algorithm = Mabc(CONFIG, arrays, JUDGE, [0])
    policy = LearnedPolicy("mabc", algorithm.agents(0), REACH)
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
    arrays: EpisodeArrays,
) -> None:
    policy = LearnedPolicy("mabc", Mabc(CONFIG, arrays, JUDGE, [0]).agents(0), REACH)
    state = np.random.default_rng(1).normal(size=10)
    joint = policy.act(state)
    goal = {"observation": state[:7], "achieved_goal": state[:3]}
    np.testing.assert_array_equal(
        policy.act({**goal, "desired_goal": state[7:]}), joint
    )
    agents = policy.act_agents(split_state(state, REACH))
    np.testing.assert_array_equal(np.concatenate(list(agents.values())), joint)
    assert (joint >= [-1, -1, -1, 0]).all() and (joint <= 1).all()
    with pytest.raises(UsageError, match=r"shape \(9,\)"):
        policy.act(state[:9])


def test_a_loaded_policy_acts_equally_without_the_dataset(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    algorithm = Mabc(CONFIG, arrays, JUDGE, [0])
    for _ in range(5):
        algorithm.update()
    save_seed(tmp_path / FILE, algorithm, 0)
    policy = LearnedPolicy("mabc", algorithm.agents(0), REACH)
    for loaded in (load_policy(tmp_path), load_policy(tmp_path / FILE)):
        for state in np.random.default_rng(2).normal(size=(20, 10)):
            np.testing.assert_array_equal(loaded.act(state), policy.act(state))


def test_same_seed_same_weights_and_other_seed_others(
    arrays: EpisodeArrays,
) -> None:
    runs = [Mabc(CONFIG, arrays, JUDGE, [seed]) for seed in (1, 1, 2)]
    for algorithm in runs:
        torch.rand(3)  # the global generator must not matter
        for _ in range(10):
            algorithm.update()
    pairs = zip(weights(runs[0]), weights(runs[1]), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    assert not torch.equal(weights(runs[0])[2], weights(runs[2])[2])


def test_resume_continues_bit_equally(arrays: EpisodeArrays, tmp_path: Path) -> None:
    """Stopped in the middle by a real KeyboardInterrupt, then resumed."""
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    whole.mkdir()
    stopped.mkdir()
    reference = Mabc(CONFIG, arrays, JUDGE, [3])
    train(reference, [whole], no_evaluation, 100)

    def interrupt(policy: LearnedPolicy) -> CurvePoint:
        if cut.step == 200:
            raise KeyboardInterrupt
        return {}

    cut = Mabc(CONFIG, arrays, JUDGE, [3])
    with pytest.raises(KeyboardInterrupt, match="go on with `resume=True`"):
        train(cut, [stopped], interrupt, 100)
    again = Mabc(CONFIG, arrays, JUDGE, [3])
    resume_seeds(again, [stopped])
    assert again.step == 100  # the last checkpoint
    train(again, [stopped], no_evaluation, 100)
    pairs = zip(weights(reference), weights(again), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    assert read_metrics(whole) == read_metrics(stopped)
    assert (whole / "metrics.jsonl").read_bytes() == (
        stopped / "metrics.jsonl"
    ).read_bytes()


def test_evaluation_comes_when_it_was_asked_for(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    """At 0, every 130 and the end, whatever the rhythm of the log is."""
    algorithm = Mabc(CONFIG, arrays, JUDGE, [0])
    point: CurvePoint = {"success/all": 0.5, "return/all": 0.0}
    train(algorithm, [tmp_path], lambda policy: point, 130)
    rows = read_metrics(tmp_path)
    measured = [row["step"] for row in rows if "success/all" in row]
    assert measured == [0, 130, 260, 300]
    assert [row["step"] for row in rows] == [0, 100, 130, 200, 260, 300]


def test_the_best_policy_is_kept(arrays: EpisodeArrays, tmp_path: Path) -> None:
    """Of the learning curve's points; of equals the first; also after a resumption."""
    algorithm = Mabc(CONFIG, arrays, JUDGE, [0])
    rates = iter([0.1, 0.5, 0.5, 0.4])
    acted: list[np.ndarray] = []

    def evaluate(policy: LearnedPolicy) -> CurvePoint:
        acted.append(policy.act(np.ones(10)))
        return {"success/all": next(rates), "return/all": 0.0}

    def stop(done: int, note: str) -> None:
        if algorithm.step == 200:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(algorithm, [tmp_path], evaluate, 100, stop)
    again = Mabc(CONFIG, arrays, JUDGE, [0])
    resume_seeds(again, [tmp_path])
    train(again, [tmp_path], evaluate, 100)
    assert len(acted) == 4
    best = load_policy(tmp_path / BEST).act(np.ones(10))
    np.testing.assert_array_equal(best, acted[1])


def test_a_nan_ends_with_the_last_checkpoint(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    algorithm = Mabc(CONFIG, arrays, JUDGE, [0])

    def spoil(done: int, note: str) -> None:
        if algorithm.step == 200:
            algorithm.normalizer.mean.fill_(float("nan"))

    with pytest.raises(DivergedError, match=r"nan with seed 0 .* of update 200"):
        train(algorithm, [tmp_path], no_evaluation, 100, spoil)
    assert np.isfinite(load_policy(tmp_path).act(np.zeros(10))).all()
    assert read_metrics(tmp_path)[-1]["step"] == 200


def test_resume_refuses_another_config(arrays: EpisodeArrays, tmp_path: Path) -> None:
    train(Mabc(CONFIG, arrays, JUDGE, [0]), [tmp_path], no_evaluation, 1000)
    other = Mabc(replace(CONFIG, learning_rate=1e-3), arrays, JUDGE, [0])
    with pytest.raises(UsageError, match=r"learning_rate = 0\.0005 \(now 0\.001\)"):
        resume_seeds(other, [tmp_path])


def test_resume_refuses_numbers_of_another_type(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    """Half of the digits would be gone; the seed is named."""
    runs = [tmp_path / str(seed) for seed in (0, 1)]
    for run in runs:
        run.mkdir()
    train(Mabc(CONFIG, arrays, JUDGE, [0, 1]), runs, no_evaluation, 1000)
    checkpoint = torch.load(runs[1] / FILE, weights_only=True)
    actor = checkpoint["state"]["actors"]["balance"]
    actor["layers.0.bias"] = actor["layers.0.bias"].half()
    torch.save(checkpoint, runs[1] / FILE)
    with pytest.raises(CheckpointError, match=r"1/checkpoint.*bias has torch\.float16"):
        resume_seeds(Mabc(CONFIG, arrays, JUDGE, [0, 1]), runs)


def test_a_checkpoint_of_another_algorithm_is_named(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    save_seed(tmp_path / FILE, Mabc(CONFIG, arrays, JUDGE, [0]), 0)
    checkpoint = torch.load(tmp_path / FILE, weights_only=True)
    torch.save({**checkpoint, "algorithm": "cql"}, tmp_path / FILE)
    with pytest.raises(CheckpointError, match="'cql', expected 'mabc'"):
        read_checkpoint(tmp_path, "mabc")


def test_a_checkpoint_acts_whatever_has_learnt_it(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    """Actors and layout are enough: neither the algorithm nor its config is needed."""
    algorithm = Mabc(CONFIG, arrays, JUDGE, [0])
    save_seed(tmp_path / FILE, algorithm, 0)
    checkpoint = torch.load(tmp_path / FILE, weights_only=True)
    other = {"algorithm": "not-installed", "config": {"whatever": 1}}
    torch.save({**checkpoint, **other}, tmp_path / FILE)
    policy = LearnedPolicy("mabc", algorithm.agents(0), REACH)
    state = arrays.states[0]
    np.testing.assert_array_equal(load_policy(tmp_path).act(state), policy.act(state))


def test_damaged_and_missing_checkpoints_are_named(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match="no checkpoint at"):
        load_policy(tmp_path)
    (tmp_path / FILE).write_bytes(b"")
    with pytest.raises(CheckpointError, match="damaged"):
        load_policy(tmp_path)
    save_seed(tmp_path / FILE, Mabc(CONFIG, arrays, JUDGE, [0]), 0)
    whole = torch.load(tmp_path / FILE, weights_only=True)
    content = (tmp_path / FILE).read_bytes()
    (tmp_path / FILE).write_bytes(content[: len(content) // 2])
    with pytest.raises(CheckpointError, match="damaged"):
        load_policy(tmp_path)
    torch.save([1, 2], tmp_path / FILE)
    with pytest.raises(CheckpointError, match="is not a"):
        read_checkpoint(tmp_path)
    unknown = {**whole["layout"], "desired": ["goal_x", "goal_y", "nothing"]}
    blind = {**whole["layout"], "agents": [["balance", ["base_x"], ["alpha"]]]}
    fewer = {**whole["layout"], "agents": whole["layout"]["agents"][:1]}
    narrow = {**whole["layout"], "state": whole["layout"]["state"][:9]}
    seen = [[name, sees[1:], sets] for name, sees, sets in whole["layout"]["agents"]]
    for broken, message in (
        ({"layout": unknown}, "desired has nothing, which the state lacks"),
        ({"layout": blind}, "expected each of delta_x"),
        ({"layout": fewer}, "expected each of delta_x"),
        ({"layout": narrow}, "goal_z, which the state lacks"),
        ({"layout": {**whole["layout"], "agents": seen}}, "damaged"),
        ({"layout": 5}, "layout: int is not a dict"),
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
    "bad", [{"updates": -1}, {"batch_size": -1}, {"learning_rate": 0.0}, {"hidden": ()}]
)
def test_bad_hyper_parameters_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(UsageError, match=next(iter(bad))):
        replace(MabcConfig(), **bad)  # type: ignore[arg-type]


def test_normalizer_by_hand_and_its_floor() -> None:
    data = torch.tensor([[1.0, 5.0], [3.0, 5.0]])
    normalizer = Normalizer.of(data, floor=0.01)
    result = normalizer(torch.tensor([[4.0, 5.1]]))
    torch.testing.assert_close(result, torch.tensor([[2.0, 10.0]]), atol=1e-4, rtol=0)


def test_actors_undo_what_batches_do_to_actions() -> None:
    low, high = torch.tensor(REACH.low), torch.tensor(REACH.high)
    actions = low + torch.rand(8, len(low)) * (high - low)
    scaled = torch.from_numpy(normalized_actions(actions.numpy(), REACH))
    assert scaled.abs().max() <= 1
    back = ActionScale(low, high).denormalize(scaled)
    torch.testing.assert_close(back, actions)


def test_actions_are_within_bounds_that_sums_round_beyond() -> None:
    low, high = torch.meshgrid(torch.arange(-20, 0), torch.arange(0, 20), indexing="ij")
    scale = ActionScale(low.flatten() / 20, high.flatten() / 20)
    for end in (-1.0, 1.0):
        action = scale.denormalize(torch.full((400,), end))
        assert (action >= low.flatten() / 20).all()
        assert (action <= high.flatten() / 20).all()


def test_a_row_that_cannot_be_written_has_no_checkpoint(
    arrays: EpisodeArrays, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that the run goes on once there is room."""

    def full(path: Path, data: bytes) -> None:
        if b'"step": 200' in data:
            raise OSError(errno.ENOSPC, "no room", str(path))
        append(path, data)

    with monkeypatch.context() as patch, pytest.raises(OSError, match="no room"):
        patch.setattr("marl_mm.algorithms.runlog.append", full)
        train(Mabc(CONFIG, arrays, JUDGE, [3]), [tmp_path], no_evaluation, 100)
    again = Mabc(CONFIG, arrays, JUDGE, [3])
    resume_seeds(again, [tmp_path])
    train(again, [tmp_path], no_evaluation, 100)
    assert [row["step"] for row in read_metrics(tmp_path)] == [0, 100, 200, 300]
