"""Replay and hindsight: relabelled transitions against a brute-force recomputation."""

from collections.abc import Callable, Mapping

import numpy as np
import pytest
import torch

from marl_mm.algorithms.demonstrations import Demonstrations
from marl_mm.algorithms.replay import Batch, Replay
from marl_mm.envs.goal_env import GoalEnv
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.envs.tasks.carry import Carry
from marl_mm.envs.tasks.reach import Reach
from marl_mm.episode import Episode
from marl_mm.errors import UsageError

REACHING = [name for name, task in TASKS.items() if isinstance(task, Reach)]
CARRYING = [name for name in REACHING if isinstance(TASKS.get(name), Carry)]

MakeEpisode = Callable[..., Episode]
JUDGE = make_task("SmoothReach-v0")


def near(episode: Episode, scale: float = 0.05) -> Episode:
    """The episode so close together that many goals count as reached."""
    episode.states[:, episode.layout.achieved] *= scale
    return episode


@pytest.fixture
def some(make_episode: MakeEpisode) -> list[Episode]:
    return [near(make_episode(i, steps=3 + i % 5)) for i in range(12)]


def filled(episodes: list[Episode], hindsight: int, capacity: int = 1000) -> Replay:
    replay = Replay(capacity, hindsight, JUDGE, JUDGE.layout)
    for episode in episodes:
        replay.add(episode)
    return replay


def origin(batch: Batch, row: int, episodes: list[Episode]) -> tuple[Episode, int]:
    """The episode and step a transition is of, found by its goal-free observation."""
    observation = batch.observation[row, :7].numpy()
    for episode in episodes:
        known = episode.states[:-1, :7].astype(np.float32)
        found = np.flatnonzero((known == observation).all(axis=1))
        if len(found):
            return episode, int(found[0])
    raise AssertionError("a transition of no episode")


@pytest.mark.parametrize("task", CARRYING)
def test_what_failed_has_failed_whatever_the_goal(
    make_episode: MakeEpisode, task: str
) -> None:
    """Also where the goal is where the block was when it was dropped."""
    config = make_task(task)
    episode = near(make_episode(0, 6, layout=config.layout))
    episode.terminated[:] = np.arange(6) == 5
    episode.info["is_success"][:] = 0
    replay = Replay(100, 4, config, config.layout)
    replay.add(episode)
    batch = replay.sample(400, np.random.default_rng(0))
    ends = [origin(batch, row, [episode])[1] == 5 for row in range(400)]
    assert isinstance(config, Carry) and 20 < sum(ends) < 120
    costs = {name: episode.info[name][5] for name in config.needs if name != "held"}
    failed = config.load.failure_reward - (
        config.ee_error_weight * costs["d_mm"]
        + config.base_error_weight * costs["d_mp"]
        + config.jerk_weight * costs["base_jerk_rms"]
    )
    relabelled = batch.reward[ends].numpy() != np.float32(episode.rewards[5])
    assert relabelled.any()
    np.testing.assert_allclose(batch.reward[ends][relabelled], failed, rtol=1e-6)
    assert batch.terminated[ends].all()


@pytest.mark.parametrize("capacity", [1000, 23])
@pytest.mark.parametrize("task", REACHING)
def test_relabelled_transitions_equal_a_brute_force_recomputation(
    make_episode: MakeEpisode, task: str, capacity: int
) -> None:
    """Every goal is the original or where the same episode came to later; reward and
    termination are what the environment says of the step with that goal."""
    config = make_task(task)
    layout, env = config.layout, GoalEnv(task)
    some = [near(make_episode(i, 3 + i % 5, layout=layout)) for i in range(12)]
    replay = Replay(capacity, 4, config, layout)  # 23: a full ring
    for episode in some:
        replay.add(episode)
    batch = replay.sample(2000, np.random.default_rng(0))
    relabelled = ended = 0
    for row in range(2000):
        episode, step = origin(batch, row, some)
        goal = batch.observation[row, layout.goal].numpy()
        np.testing.assert_array_equal(
            batch.next_observation[row, layout.goal].numpy(), goal
        )
        later = episode.states[step + 1 :, layout.achieved].astype(np.float32)
        source = np.flatnonzero((later == goal).all(axis=1))
        if not len(source):
            original = episode.states[step, layout.goal].astype(np.float32)
            np.testing.assert_array_equal(goal, original)
            assert batch.reward[row] == np.float32(episode.rewards[step])
            assert batch.terminated[row] == episode.terminated[step]
            continue
        relabelled += 1
        exact = episode.states[step + 1 + source[0], layout.achieved]
        hand = episode.states[step + 1, layout.achieved]
        info = {name: episode.info[name][step] for name in Reach.needs}
        info["held"] = True
        if "held" in layout.state_names:
            info["held"] = episode.states[step + 1, layout.columns("held")].item()
        info["reason"] = "dropped" if episode.failed[step] else ""
        reward = env.compute_reward(hand, exact, info)
        ends = env.compute_terminated(hand, exact, info)
        assert batch.reward[row] == np.float32(reward)
        assert batch.terminated[row] == ends
        ended += bool(ends)
        if source[0] == 0:
            assert ends == info["held"], "it is where the step itself ended"
    env.close()
    assert 0.77 < relabelled / 2000 < 0.83  # k = 4 of 5
    assert 0 < ended < relabelled


def test_future_goals_are_uniform_over_the_rest_of_the_episode(
    make_episode: MakeEpisode,
) -> None:
    episode = make_episode(0, steps=4)
    batch = filled([episode], hindsight=10**9).sample(8000, np.random.default_rng(1))
    first = batch.observation[:, 0].numpy() == np.float32(episode.states[0, 0])
    goals = batch.observation[first][:, 7].numpy()
    counts = [(goals == np.float32(x)).sum() for x in episode.states[1:, 0]]
    assert sum(counts) == first.sum()
    np.testing.assert_allclose(np.array(counts) / first.sum(), 0.25, atol=0.04)


def test_without_hindsight_everything_is_as_it_happened(some: list[Episode]) -> None:
    batch = filled(some, hindsight=0).sample(500, np.random.default_rng(0))
    for row in range(500):
        episode, step = origin(batch, row, some)
        np.testing.assert_array_equal(
            batch.observation[row].numpy(), episode.states[step].astype(np.float32)
        )
        assert batch.reward[row] == np.float32(episode.rewards[step])
        alpha = 2 * episode.actions[step, 3] - 1
        assert batch.action[row, 3] == pytest.approx(alpha, abs=1e-6)


def test_the_oldest_episodes_go_whole(make_episode: MakeEpisode) -> None:
    episodes = [make_episode(i, steps=5) for i in range(10)]
    replay = filled(episodes, hindsight=4, capacity=23)
    assert len(replay) == 20
    batch = replay.sample(2000, np.random.default_rng(0))
    seen = {origin(batch, row, episodes)[0].index for row in range(2000)}
    assert seen == {6, 7, 8, 9}


def test_an_episode_longer_than_the_replay_is_refused(
    make_episode: MakeEpisode,
) -> None:
    with pytest.raises(UsageError, match="has 5 steps, but the replay's capacity is 4"):
        filled([make_episode(0, steps=5)], hindsight=0, capacity=4)


def test_a_restored_replay_gives_the_same_batches(make_episode: MakeEpisode) -> None:
    """After the ring has gone round, and for episodes that come later."""
    episodes = [make_episode(i, steps=5) for i in range(12)]
    replay = filled(episodes[:9], hindsight=4, capacity=23)
    other = Replay(23, 4, JUDGE, JUDGE.layout)
    other.load_state(replay.state())
    for episode in episodes[9:]:
        replay.add(episode)
        other.add(episode)
        ours, theirs = (r.sample(64, np.random.default_rng(3)) for r in (replay, other))
        assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))


class Named:
    """A judge whose cost is called as an array of the replay's own."""

    needs = ("reward",)
    highest_return = None

    def judge(
        self, achieved: np.ndarray, desired: np.ndarray, terms: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        return terms["reward"], np.zeros(len(achieved), bool)


def test_costs_are_kept_whatever_their_names(make_episode: MakeEpisode) -> None:
    replay, other = (Replay(50, 4, Named(), JUDGE.layout) for _ in range(2))
    for number in range(5):
        episode = make_episode(number, steps=5)
        episode.info["reward"] = 100 + episode.rewards
        replay.add(episode)
    other.load_state(replay.state())
    ours, theirs = (r.sample(64, np.random.default_rng(3)) for r in (replay, other))
    assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))
    assert (ours.reward > 50).any() and (ours.reward < 50).any()


def test_judge_is_the_environments_own(some: list[Episode]) -> None:
    """Bit-equal to what ``compute_reward`` and ``compute_terminated`` say."""
    env = GoalEnv("SmoothReach-v0")
    for episode in some:
        hands, goals = episode.states[1:, slice(0, 3)], episode.states[:-1, slice(0, 3)]
        costs: Mapping[str, np.ndarray] = {
            name: episode.info[name] for name in JUDGE.needs
        }
        reward, ends = JUDGE.judge(
            hands, goals, {**costs, "failed": np.zeros(len(hands))}
        )
        np.testing.assert_array_equal(reward, env.compute_reward(hands, goals, costs))
        np.testing.assert_array_equal(ends, env.compute_terminated(hands, goals, costs))
    env.close()


def test_demonstrations_keep_the_ratio_of_successes(make_episode: MakeEpisode) -> None:
    good = [make_episode(i, steps=5, success=True) for i in range(2)]
    bad = [make_episode(i, steps=5, success=False) for i in range(2, 10)]
    demonstrations = Demonstrations(good + bad, 0.75, 0, JUDGE)
    batch = demonstrations.sample(4000, np.random.default_rng(0))
    successes = [origin(batch, row, good + bad)[0].success for row in range(4000)]
    for half in (successes[:2000], successes[2000:]):  # the order is random
        assert np.mean(half) == pytest.approx(0.75, abs=0.03)


def test_demonstrations_of_one_kind_and_of_none(make_episode: MakeEpisode) -> None:
    bad = [make_episode(i, steps=5, success=False) for i in range(3)]
    only = Demonstrations(bad, 0.75, 0, JUDGE)
    assert len(only.sample(9, np.random.default_rng(0)).reward) == 9
    assert not Demonstrations([], 0.75, 0, JUDGE)
