"""Episodes in threads and processes are those of a single process."""

import threading
from contextlib import closing
from itertools import count

import numpy as np
import psutil
import pytest

from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.collectors.replay import ReplayPolicy
from marl_mm.envs import slots
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import EpisodePlan, Rollouts, run_episode
from marl_mm.envs.task import Task
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.layout import Layout
from marl_mm.policy import Policy
from marl_mm.runs.policies import load_policy

MUJOCO = {"engine": "mujoco"}

PLANS = [EpisodePlan(i, 10 + i) for i in range(5)]


def noisy() -> Explorer:
    policy = load_policy("pretrained")
    assert isinstance(policy, LearnedPolicy)
    return Explorer(policy, noise=0.1, random_share=0.2)


def content(episode: Episode) -> tuple[object, ...]:
    arrays = episode.states, episode.actions, episode.rewards, episode.start
    info = [(name, values.tobytes()) for name, values in episode.info.items()]
    return episode.index, *(array.tobytes() for array in arrays), *info


def kinds() -> tuple[int, int]:
    """Numbers of threads and of worker processes."""
    me = psutil.Process()
    others = [p for p in me.children(recursive=True) if p.ppid() != me.pid]
    return threading.active_count(), len(others)


def run(task: Task, policy: Policy, workers: int) -> list[Episode]:
    with Rollouts(task, workers) as rollouts:
        return list(rollouts.run(policy, PLANS))


class Loud:
    """Acts in float64, and out of bounds."""

    name = "loud"

    def describe(self) -> dict[str, object]:
        return {}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        self._rng = rng

    def act(self, state: np.ndarray) -> np.ndarray:
        return self._rng.uniform(-1.3, 1.3, 4)


def test_what_is_kept_is_what_was_carried_out() -> None:
    task = make_task("Reach-v0", {"max_steps": 2, "simulation": {"engine": "mujoco"}})
    with closing(EpisodeCore(task)) as core:
        episode = run_episode(core, Loud(), EpisodePlan(0, 3))
        again = run_episode(core, ReplayPolicy(episode), EpisodePlan(0, 3))
    assert episode.actions.dtype == np.float32
    low, high = task.layout.low, task.layout.high
    assert (episode.actions >= low).all() and (episode.actions <= high).all()
    assert content(episode) == content(again)


class Writer(Loud):
    """Centres the state in place, as many a policy of others does."""

    def act(self, state: np.ndarray) -> np.ndarray:
        state -= 5.0
        return np.zeros(4)


def test_a_policy_that_writes_into_its_state_changes_no_record() -> None:
    task = make_task("Reach-v0", {"max_steps": 2, "simulation": {"engine": "mujoco"}})
    with closing(EpisodeCore(task)) as core:
        episode = run_episode(core, Writer(), EpisodePlan(0, 3))
        again = run_episode(core, ReplayPolicy(episode), EpisodePlan(0, 3))
    assert content(episode) == content(again)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["blend", "rhp"])
def test_threads_and_processes_run_the_same_episodes(
    monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    simulation, controller = {"engine": "mujoco"}, {"form": form}
    settings = {"simulation": simulation, "controller": controller, "max_steps": 4}
    task, policy = make_task("Reach-v0", settings), noisy()
    alone = [content(episode) for episode in run(task, policy, 1)]
    threads, processes = kinds()
    with Rollouts(task, 2) as rollouts:
        episodes = list(rollouts.run(policy, PLANS))
        assert kinds() == (threads + 2, processes)
        ready = rollouts.completed(policy, PLANS)
        assert sorted(episode.index for episode in ready) == list(range(5))
    assert [content(episode) for episode in episodes] == alone
    assert kinds() == (threads, processes)
    monkeypatch.setattr(slots, "MOST_THREADS", 1)
    with Rollouts(task, 2) as rollouts:
        episodes = list(rollouts.run(policy, PLANS))
        assert kinds()[1] == processes + 2
    assert [content(episode) for episode in episodes] == alone


@pytest.fixture(params=[1, 4])
def processes_or_threads(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two workers are processes, and then threads."""
    monkeypatch.setattr(slots, "MOST_THREADS", request.param)


@pytest.mark.slow
@pytest.mark.usefixtures("processes_or_threads")
def test_what_is_left_undone_does_not_reach_the_next_episodes() -> None:
    """Of plans without end, as collections have; in processes and in threads."""
    task = make_task("Reach-v0", {"simulation": {"engine": "mujoco"}, "max_steps": 2})
    alone = [content(episode) for episode in run(task, Loud(), 1)]
    endless = (EpisodePlan(i, 99) for i in count())
    with Rollouts(task, 2) as rollouts:
        episodes = rollouts.completed(Loud(), endless)
        next(episodes)
        episodes.close()
        begun = next(endless).index
        assert begun <= 6  # two for each worker, and those after the first
        assert [content(e) for e in rollouts.run(Loud(), PLANS)] == alone


@pytest.mark.slow
@pytest.mark.usefixtures("processes_or_threads")
def test_a_robot_that_falls_is_refused_in_workers_too() -> None:
    """In one line: in processes and in threads."""
    fields = {"robot": {"base_com_b": (1.0, 0, 0.2)}, "simulation": MUJOCO}
    with Rollouts(make_task("Reach-v0", fields), 2) as rollouts:
        with pytest.raises(UsageError, match="robot"):
            list(rollouts.run(Loud(), PLANS))


def test_threads_serve_only_where_steps_leave_others_be() -> None:
    for name in ("Grasp-v0", "Bar-v0", "Course-v0"):  # looks at contacts are Python
        blocks = make_task(name, {"simulation": {"engine": "mujoco"}})
        assert not slots.threads_serve(blocks, 2)
    for settings, workers, serve in (
        ({"simulation": {"engine": "mujoco"}}, 4, True),
        ({"simulation": {"engine": "mujoco"}}, 5, False),
        ({"simulation": {"engine": "bullet"}}, 2, False),
        (
            {
                "simulation": {"engine": "mujoco"},
                "controller": {"solver": "proxqp"},
            },
            2,
            False,
        ),
    ):
        assert slots.threads_serve(make_task("Reach-v0", settings), workers) == serve


def test_a_policy_goes_on_learning_while_its_episodes_run() -> None:
    """A worker acts with the weights of when the episode was handed out."""
    task = make_task("Reach-v0", {"simulation": {"engine": "mujoco"}, "max_steps": 2})
    policy = load_policy("pretrained")
    assert isinstance(policy, LearnedPolicy)
    with Rollouts(task, 2) as rollouts:
        expected = [content(episode) for episode in rollouts.run(policy, PLANS)]
        episodes = rollouts.run(policy, PLANS)
        first = next(episodes)
        for agent in policy.agents.values():
            for weight in agent.actor.parameters():
                weight.data.zero_()
        assert [content(e) for e in (first, *episodes)] == expected
    assert not np.isnan(first.states).any()


def test_a_policys_random_numbers_follow_from_the_episodes_seed_alone() -> None:
    """Not from its number: two collections begin with the same ones."""
    task = make_task("Reach-v0", {"max_steps": 1, "simulation": {"engine": "mujoco"}})
    policy = RandomPolicy(RandomConfig())
    with closing(EpisodeCore(task)) as core:
        first, same, other = (
            run_episode(core, policy, EpisodePlan(index, seed)).actions
            for index, seed in ((0, 3), (1, 3), (0, 4))
        )
    assert np.array_equal(first, same) and (first != other).all()
