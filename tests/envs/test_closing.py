"""Environments that are closed say so; those that nobody closed are freed."""

import gc
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import psutil
import pytest

import marl_mm  # noqa: F401  registers the environments
from marl_mm.envs import parallel_env
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.goal_env import GoalEnv
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.envs.tasks.reach import Reach
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.robot.description import RobotConfig
from marl_mm.sim.bullet.engine import pybullet
from marl_mm.sim.bullet.world import BulletWorld
from marl_mm.sim.config import SimulationConfig
from marl_mm.sim.scene import Block, Scene

REACHING = [name for name, task in TASKS.items() if isinstance(task, Reach)]

CLOSED = "the environment is closed: make another"


@pytest.fixture
def no_collector() -> Iterator[None]:
    """Python's collector of reference cycles is off."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def is_open(client: int) -> bool:
    return bool(pybullet.getConnectionInfo(client)["isConnected"])


MAKERS: dict[str, Callable[[str], Any]] = {
    "goal": GoalEnv,
    "team": parallel_env,
    "gymnasium": lambda task: gymnasium.make(f"marl_mm/{task}").unwrapped,
}


@pytest.mark.bullet
@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.parametrize("task", REACHING)
def test_an_environment_that_nothing_refers_to_is_freed(
    no_collector: None, task: str, maker: str
) -> None:
    """At once, as it is no part of a cycle; PyBullet would keep it for good."""
    env = MAKERS[maker](task)
    env.reset(seed=0)
    if maker == "team":
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    else:
        env.step(env.action_space.sample())
    worlds = [drive.world for drive in env.core.drives]
    clients = [world.client for world in worlds]
    references = [weakref.ref(world) for world in worlds]
    assert all(map(is_open, clients))
    del env, worlds
    assert [reference() for reference in references] == [None] * len(clients)
    assert not any(map(is_open, clients))


def test_episodes_leave_nothing_in_memory() -> None:
    """PyBullet keeps what it reads from a file by the file's name."""
    env = GoalEnv("Reach-v0")
    process = psutil.Process()
    for number in range(250):
        if number == 50:
            before = process.memory_info().rss
        env.reset(seed=number)
    assert process.memory_info().rss - before < 1_000_000  # [bytes]; it was 2.4e6
    env.close()


def test_a_world_reads_the_robot_that_it_asks_for() -> None:
    """With and without solid hands in turn, and of its mass beside another world."""
    heavy = BulletWorld(RobotConfig(base_mass=50.0), SimulationConfig())
    light = BulletWorld(RobotConfig(base_mass=40.0), SimulationConfig())
    scene = Scene(Block(), (0.65, 0.1, 0.58), grasp="weld")
    hands = []
    for given in (None, scene, None, scene):
        for world, mass in ((heavy, 50.0), (light, 40.0)):
            world.reset(scene=given)
            client = {"physicsClientId": world.client}
            assert pybullet.getDynamicsInfo(1, -1, **client)[0] == mass
            links = range(pybullet.getNumJoints(1, **client))
            shapes = [pybullet.getCollisionShapeData(1, i, **client) for i in links]
            hands.append(sum(map(bool, shapes)))
    assert hands[:2] == hands[4:6] < hands[2:4] == hands[6:], hands
    heavy.close()
    light.close()


def bullet_of(core: EpisodeCore) -> BulletWorld:
    if not isinstance(core.drive.world, BulletWorld):
        pytest.skip("not on PyBullet")
    return core.drive.world


def test_a_number_that_is_given_again_is_not_closed_by_the_old_world() -> None:
    first = EpisodeCore(make_task())
    client = bullet_of(first).client
    first.close()
    second = EpisodeCore(make_task())
    assert bullet_of(second).client == client
    first.close()
    del first
    second.reset(np.random.default_rng(0))
    second.close()


def test_no_room_for_another_world_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pybullet, "connect", lambda mode: -1)
    with pytest.raises(MarlMmError, match=r"no room .* close\(\) some"):
        EpisodeCore(make_task())


def test_a_closed_core_says_so() -> None:
    core = EpisodeCore(make_task())
    rng = np.random.default_rng(0)
    core.reset(rng)
    core.close()
    core.close()
    for call in (
        lambda: core.step(np.zeros(4)),
        lambda: core.push(np.zeros(4)),
        lambda: core.reset(rng),
        lambda: core.render(core.task.camera),
    ):
        with pytest.raises(UsageError, match=CLOSED):
            call()


@pytest.mark.parametrize("begun", [False, True])
def test_a_closed_goal_environment_says_so(begun: bool) -> None:
    env = gymnasium.make("marl_mm/Reach-v0", render_mode="rgb_array")
    if begun:
        env.reset(seed=0)
    env.close()
    env.close()
    bare = env.unwrapped
    for call in (
        lambda: env.reset(seed=0),
        lambda: bare.step(np.zeros(4, np.float32)),
        lambda: bare.render(),
    ):
        with pytest.raises(UsageError, match=CLOSED):
            call()


@pytest.mark.parametrize("begun", [False, True])
def test_a_closed_team_environment_says_so(begun: bool) -> None:
    """Also where no episode runs, in which a step would do nothing."""
    env = parallel_env("Reach-v0", render_mode="rgb_array")
    if begun:
        env.reset(seed=0)
    actions = {name: env.action_space(name).sample() for name in env.possible_agents}
    env.close()
    env.close()
    for call in (lambda: env.step(actions), lambda: env.reset(), lambda: env.render()):
        with pytest.raises(UsageError, match=CLOSED):
            call()
