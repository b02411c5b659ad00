"""Environments stay as they are, however long they run and whatever they are told.

The usual test run takes a few hundred steps a task. A long one, of one task:

    MARL_MM_LONG_STEPS=100000 pytest tests/envs/test_long_run.py -k "[Reach-v0]" \
        -o faulthandler_timeout=0 -o log_cli=true --log-cli-level=INFO
"""

import gc
import logging
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import gymnasium
import numpy as np
import psutil
import pytest

from marl_mm.envs import parallel_env
from marl_mm.envs.goal_env import GoalEnv
from marl_mm.envs.parallel import split_action
from marl_mm.envs.registry import TASKS
from marl_mm.envs.tasks.reach import Reach
from marl_mm.errors import InvalidActionError
from marl_mm.layout import Layout
from marl_mm.sim.bullet.engine import pybullet

REACHING = [name for name, task in TASKS.items() if isinstance(task, Reach)]

STEPS = int(os.environ.get("MARL_MM_LONG_STEPS", "60"))
"""Number of steps per task."""

LONG = STEPS >= 5_000
"""Whether there are enough steps for memory to say something."""

OPENED = 200 if LONG else 20
"""Number of environments that are opened and closed."""

WARM = 0.1
"""Share of the steps after which memory has to stay flat."""

GROWTH = 1.05
"""Largest ratio of the memory at any time to the memory after that share."""

REPORTS = 100
"""Number of lines in the log of a long run."""

PAST_THE_END = 10
"""Steps that every fourth episode goes on after its end."""

CLIENTS = 1024
"""Number of worlds that PyBullet has room for."""

Draw = Callable[[np.ndarray, np.ndarray], np.ndarray]

log = logging.getLogger(__name__)


def actions(layout: Layout, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Joint actions of five kinds, for a few steps each: at random, at the bounds, from
    bound to bound, none, and far beyond the bounds."""
    low, high = np.array(layout.low), np.array(layout.high)
    while True:
        kind, steps = rng.integers(5), rng.integers(1, 12)
        corner = rng.integers(2, size=len(low)).astype(bool)
        for step in range(steps):
            if kind == 0:
                action = rng.uniform(low, high)
            elif kind == 1:
                action = np.where(corner, low, high)
            elif kind == 2:
                action = np.where(corner ^ bool(step % 2), low, high)
            elif kind == 3:
                action = np.zeros(len(low))
            else:
                action = np.where(corner, -1.0, 1.0) * 10.0 ** rng.integers(1, 38)
            yield action.astype(np.float32)


def memory() -> float:
    """Resident memory of this process without garbage [MB]."""
    gc.collect()
    return float(psutil.Process().memory_info().rss / 1e6)


def clients() -> int:
    """Number of worlds that are connected to PyBullet."""
    infos = (pybullet.getConnectionInfo(number) for number in range(CLIENTS))
    return sum(info["isConnected"] for info in infos)


class Runner:
    """Plays episodes of a task in both of its environments in turn.

    Args:
        task: Name of the task.
        seed: Seed of the environments and of the actions.
    """

    def __init__(self, task: str, seed: int) -> None:
        self.goal_env, self.team_env = GoalEnv(task), parallel_env(task)
        rng = np.random.default_rng(seed)
        self._layout = self.goal_env.task.layout
        self._actions = actions(self._layout, rng)
        self._resets = np.random.default_rng(seed)
        self.episodes = 0

    def episode(self) -> int:
        """Play an episode; return the number of its steps."""
        self.episodes += 1
        seed = int(self._resets.integers(2**31))
        return self._team(seed) if self.episodes % 2 else self._goal(seed)

    def _goal(self, seed: int) -> int:
        env = self.goal_env
        seen, _ = env.reset(seed=seed)
        assert env.observation_space.contains(seen)
        with pytest.raises(InvalidActionError, match="finite"):
            env.step(np.full(len(self._layout.action), np.nan, np.float32))
        past = PAST_THE_END if self.episodes % 4 == 0 else 0
        steps = ended = 0
        while not ended or past:
            past -= ended and past > 0
            seen, reward, terminated, truncated, info = env.step(next(self._actions))
            assert env.observation_space.contains(seen), seen
            numbers = [value for key, value in info.items() if key != "reason"]
            assert np.isfinite(reward) and np.isfinite(numbers).all(), info
            ended, steps = ended or terminated or truncated, steps + 1
        return steps

    def _team(self, seed: int) -> int:
        env = self.team_env
        seen, _ = env.reset(seed=seed)
        steps = 0
        while env.agents:
            assert env.state_space.contains(env.state()), env.state()
            for agent, observation in seen.items():
                assert env.observation_space(agent).contains(observation), observation
            action = next(self._actions)
            seen, rewards, *_ = env.step(split_action(action, self._layout))
            assert np.isfinite(list(rewards.values())).all()
            steps += 1
        return steps

    def close(self) -> None:
        self.goal_env.close()
        self.team_env.close()


@pytest.mark.slow
@pytest.mark.parametrize("task", REACHING)
def test_no_number_gets_out_of_hand_and_no_file_stays_open(task: str) -> None:
    """Nor does memory grow, where there are steps enough to see it."""
    runner, began = Runner(task, seed=1), time.monotonic()
    steps, reported, warm, most = 0, 0, 0.0, 0.0
    files = psutil.Process().num_fds()
    while steps < STEPS:
        steps += runner.episode()
        if LONG and steps * REPORTS >= (reported + 1) * STEPS:
            reported = steps * REPORTS // STEPS
            now = memory()
            if steps >= WARM * STEPS:
                warm = warm or now
                most = max(most, now)
            log.info(
                f"{task}: {steps} steps, {runner.episodes} episodes, {now:.1f} MB, "
                f"{psutil.Process().num_fds()} descriptors, "
                f"{time.monotonic() - began:.0f} s"
            )
    assert psutil.Process().num_fds() == files
    assert most <= GROWTH * warm, f"{most:.1f} MB, {warm:.1f} MB when warm"
    runner.close()


@pytest.mark.slow
@pytest.mark.parametrize("drop", [False, True])
def test_environments_leave_nothing_behind(drop: bool) -> None:
    """Whether they are closed or only dropped."""
    before, warm, files = clients(), 0.0, psutil.Process().num_fds()
    for number in range(OPENED):
        env = gymnasium.make(f"marl_mm/{TASKS.names()[number % len(TASKS.names())]}")
        env.reset(seed=number)
        env.step(env.action_space.sample())
        if not drop:
            env.close()
        del env
        if number == OPENED // 2:
            warm = memory()
    gc.collect()
    assert clients() == before and psutil.Process().num_fds() == files
    assert memory() <= GROWTH * warm
    log.info(f"{OPENED} opened: {warm:.1f} MB after half of them, {memory():.1f} MB")


def replayed(task: str, seed: int, steps: int) -> list[bytes]:
    """All observations of some steps."""
    env = GoalEnv(task)
    script = actions(env.task.layout, np.random.default_rng(seed))
    seen, _ = env.reset(seed=seed)
    result = [np.concatenate([*seen.values()]).tobytes()]
    for _ in range(steps):
        seen, _, terminated, truncated, _ = env.step(next(script))
        if terminated or truncated:
            seen, _ = env.reset()
        result.append(np.concatenate([*seen.values()]).tobytes())
    env.close()
    return result


@pytest.mark.slow
@pytest.mark.parametrize("task", ["Reach-v0", "Grasp-v0"])
def test_two_threads_get_the_bytes_of_one(task: str) -> None:
    play = partial(replayed, task, steps=min(STEPS, 2_000) // 4)
    alone = [play(seed) for seed in (1, 2)]
    with ThreadPoolExecutor(2) as threads:
        beside = list(threads.map(play, (1, 2)))
    assert beside == alone and alone[0] != alone[1]
