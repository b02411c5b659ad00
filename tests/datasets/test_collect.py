"""Collections depend on their seed alone: not on workers, not on interruptions."""

import inspect
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterable
from dataclasses import fields, make_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import marl_mm
from marl_mm.collectors.collect import RunEpisodes, collect
from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.collectors.random import RandomConfig, RandomPolicy
from marl_mm.collectors.registry import COLLECTING, Collector, everything, successes
from marl_mm.datasets.dataset import load_dataset
from marl_mm.envs.goal_env import GoalEnv
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import PURPOSES, EpisodePlan, Rollouts, episode_seed
from marl_mm.envs.task import Task
from marl_mm.envs.tasks.reach import LAYOUT as REACH
from marl_mm.episode import Episode
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.policy import Policy
from marl_mm.runs.collecting import Collecting


def runs(task: Task, workers: int = 1) -> RunEpisodes:
    """Runs attempts and yields each when it is finished."""

    def run(
        policy: Policy, plans: Iterable[EpisodePlan]
    ) -> Generator[Episode, None, None]:
        with Rollouts(task, workers) as rollouts:
            yield from rollouts.completed(policy, plans)

    return run


def same(here: list[Episode], there: list[Episode]) -> bool:
    """Byte-equal arrays and equal seeds."""
    if len(here) != len(there):
        return False
    return all(
        a.states.tobytes() == b.states.tobytes()
        and a.actions.tobytes() == b.actions.tobytes()
        and a.rewards.tobytes() == b.rewards.tobytes()
        and all(a.info[key].tobytes() == b.info[key].tobytes() for key in a.info)
        and (a.seed, a.index) == (b.seed, b.index)
        for a, b in zip(here, there, strict=True)
    )


@pytest.mark.slow
def test_one_and_two_workers_give_equal_bytes(short_task: Task) -> None:
    policy = RandomPolicy(RandomConfig())
    first = collect(policy, everything, runs(short_task, 1), 60, seed=5)
    second = collect(policy, everything, runs(short_task, 2), 60, seed=5)
    assert same(first.episodes, second.episodes)
    assert first.attempts == second.attempts
    other = collect(policy, everything, runs(short_task), 60, seed=6)
    assert not same(first.episodes, other.episodes)


def test_a_dataset_is_the_shortest_run_of_whole_episodes(
    short_task: Task,
) -> None:
    policy = RandomPolicy(RandomConfig())
    collection = collect(policy, everything, runs(short_task), 10, seed=0)
    lengths = [len(episode) for episode in collection.episodes]
    assert sum(lengths) >= 10 > sum(lengths[:-1])
    assert collection.complete


def test_a_longer_dataset_begins_with_the_shorter(short_task: Task) -> None:
    policy = RandomPolicy(RandomConfig())
    short = collect(policy, everything, runs(short_task), 8, seed=0).episodes
    long = collect(policy, everything, runs(short_task), 16, seed=0).episodes
    assert same(short, long[: len(short)])


@pytest.mark.slow
def test_pd_keeps_successes_and_they_can_be_replayed() -> None:
    task = make_task("Reach-v0", {"max_steps": 50})
    collection = collect(PdPolicy(PdConfig()), successes, runs(task), 30, seed=1)
    env = GoalEnv(overrides={"max_steps": 50})
    for episode in collection.episodes:
        assert episode.success
        observation, _ = env.reset(seed=episode.seed)
        for t, action in enumerate(episode.actions):
            np.testing.assert_array_equal(
                observation["observation"], episode.states[t, :7]
            )
            observation, reward, terminated, truncated, _ = env.step(action)
            assert reward == episode.rewards[t]
            assert (terminated, truncated) == (
                episode.terminated[t],
                episode.truncated[t],
            )
        np.testing.assert_array_equal(
            observation["achieved_goal"], episode.states[-1, :3]
        )
    env.close()


def test_episode_seeds_are_distinct_and_stable() -> None:
    seeds = {
        episode_seed(s, i, purpose)
        for s in range(10)
        for i in range(100)
        for purpose in PURPOSES
    }
    assert len(seeds) == 1000 * len(PURPOSES)
    assert max(seeds) < 2**63  # what HDF5 and Minari hold
    assert (
        episode_seed(0, 0, "collect") == 1317536309490288386
    )  # datasets of all versions rely on it


def test_a_hopeless_collector_gives_up(short_task: Task) -> None:
    hasty = runs(make_task("Reach-v0", {"ticks_per_step": 1, "max_steps": 1}))
    for keeps, why in (
        (successes, "reached no goal in 200 episodes in a row: allow more steps"),
        (lambda episode: False, "nothing to keep in 200 episodes in a row: change the"),
    ):
        with pytest.raises(MarlMmError, match=why):
            collect(PdPolicy(PdConfig()), keeps, hasty, 5, 0)


@pytest.mark.parametrize(("steps", "seed"), [(0, 0), (-5, 0), (5, -1)])
def test_bad_numbers_are_refused(short_task: Task, steps: int, seed: int) -> None:
    with pytest.raises(UsageError, match="expected >= "):
        collect(RandomPolicy(RandomConfig()), everything, runs(short_task), steps, seed)


@pytest.mark.parametrize(
    "setting",
    [{"kp": np.nan}, {"kd": np.inf}, {"alpha": 2.0}, {"room_start": 0.4}],
)
def test_bad_settings_of_pd_are_refused(setting: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=r"expected"):
        PdConfig(**setting)  # type: ignore[arg-type]


def test_settings_do_not_have_names_of_what_a_collection_is_asked_for() -> None:
    asked = {field.name for field in fields(Collecting)}
    asked |= inspect.signature(marl_mm.collect).parameters.keys() - {"settings"}
    assert {*COLLECTING} == asked
    made: Any = None
    for name in COLLECTING:
        config = make_dataclass("Config", [(name, int, 0)], frozen=True)
        with pytest.raises(
            UsageError, match=f"Config.{name} has the name of something"
        ):
            Collector(about="Mine.", config=config, policy=made)


def test_pd_steers_towards_the_goal_and_stays_in_range() -> None:
    policy = PdPolicy(PdConfig(kd=0.0))
    policy.begin(np.random.default_rng(0), REACH)
    state = np.array([0.6, 0.1, 0.6, 0, 0, 0, 1, 1.3, 0.05, 0.7])
    np.testing.assert_allclose(policy.act(state), [1.0, -0.5, 1.0, 0.5], atol=1e-6)


def test_pd_damps_the_hands_speed() -> None:
    policy = PdPolicy(PdConfig(kp=1.0, kd=2.0))
    policy.begin(np.random.default_rng(0), REACH)
    state = np.zeros(10)
    policy.act(state)
    state[0] = 0.1  # in the same array, as a robot's loop may have it
    np.testing.assert_allclose(policy.act(state)[0], -0.1 - 0.2, atol=1e-6)


@pytest.mark.parametrize(
    ("rule", "ahead", "goal", "expected"),
    [
        ("constant", 0.64, 1.2, 0.6),
        ("direction", 0.64, 1.2, 1.0),
        ("direction", 0.64, -0.6, 0.6),
        ("room", 0.70, -0.6, 1.0),
        ("room", 0.555, -0.6, 0.8),
        ("room", 0.40, -0.6, 0.6),
    ],
)
def test_alpha_rules(rule: str, ahead: float, goal: float, expected: float) -> None:
    policy = PdPolicy(PdConfig(alpha_rule=rule, alpha=0.6))  # type: ignore[arg-type]
    policy.begin(np.random.default_rng(0), REACH)
    state = np.array([ahead, 0, 0.6, 0, 0, 0, 1, goal, 0, 0.6])
    assert policy.act(state)[3] == pytest.approx(expected)


def test_random_actions_fill_the_action_space() -> None:
    policy = RandomPolicy(RandomConfig())
    policy.begin(np.random.default_rng(0), REACH)
    actions = np.stack([policy.act(np.zeros(10)) for _ in range(2000)])
    np.testing.assert_allclose(actions.min(axis=0), [-1, -1, -1, 0], atol=0.01)
    np.testing.assert_allclose(actions.max(axis=0), [1, 1, 1, 1], atol=0.01)


def read_until(terminal: int, text: str | None) -> str:
    """What a terminal shows until a text comes, or until the other side closes."""
    shown = ""
    while text is None or text not in shown:
        try:
            part = os.read(terminal, 4096)
        except OSError:  # Linux's end of file on a terminal
            break
        if not part:
            break
        shown += part.decode(errors="replace")
    return shown


def listen_to_ctrl_c() -> None:
    """Also where these tests run in a background job, which ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_leaves_the_episodes_until_then(
    datasets_home: Path, workers: int
) -> None:
    """A real interrupt of the real command: a valid dataset, a prefix of the whole."""
    place = datasets_home / "of pd"
    words = "--steps", "100000", "--seed", "2", "--dataset", str(place)
    terminal, stderr = pty.openpty()
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "marl_mm.cli", "collect", "pd"),
            *(*words, "--workers", str(workers)),
        ],
        env={**os.environ, "COLUMNS": "120"},
        stdout=subprocess.DEVNULL,
        stderr=stderr,
        preexec_fn=listen_to_ctrl_c,
        start_new_session=True,
    )
    os.close(stderr)
    shown = read_until(terminal, "3 episodes")
    for _ in range(2):  # an impatient user's second one must not hang it
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(0.1)
    shown += read_until(terminal, None)
    assert process.wait(timeout=60) == 130, shown
    assert "Traceback" not in shown
    assert "stopped; the dataset holds the episodes until then" in shown
    assert f"collect pd --dataset '{place}' --resume" in shown
    dataset = load_dataset(place)
    assert dataset.metadata["marl_mm"]["complete"] is False
    assert dataset.metadata["total_episodes"] == len(dataset.episodes) > 0
    task = make_task("Reach-v0", {"max_steps": 50})
    again = collect(PdPolicy(PdConfig()), successes, runs(task), 20, seed=2).episodes
    count = min(len(again), len(dataset.episodes))
    assert same(again[:count], dataset.episodes[:count])


def test_only_attempts_in_a_row_are_hopeless(
    make_episode: Callable[..., Episode],
) -> None:
    """One of 150 is kept, so that more than 200 are not."""

    def run(
        policy: Policy, plans: Iterable[EpisodePlan]
    ) -> Generator[Episode, None, None]:
        for plan in plans:
            yield make_episode(plan.index, steps=1)

    policy = RandomPolicy(RandomConfig())
    collection = collect(policy, lambda e: e.index % 150 == 149, run, 3, seed=0)
    assert [e.index for e in collection.episodes] == [149, 299, 449]
    assert collection.complete and collection.attempts == 450


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, np.pi, -1.0])
def test_room_is_ahead_of_the_base_wherever_it_heads(yaw: float) -> None:
    policy = PdPolicy(PdConfig(alpha_rule="room", alpha=0.6))
    policy.begin(np.random.default_rng(0), REACH)
    x, y = 0.3 + 0.555 * np.cos(yaw), -0.2 + 0.555 * np.sin(yaw)
    state = np.array([x, y, 0.6, 0.3, -0.2, yaw, 1, -0.6, 0, 0.6])
    assert policy.act(state)[3] == pytest.approx(0.8)
