"""Both interfaces keep their library's contract, and the same seed the same bytes."""

import hashlib
import subprocess
import sys
import warnings
from collections.abc import Callable
from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test

import marl_mm  # noqa: F401  registers the environments
from marl_mm.collectors.replay import ReplayPolicy
from marl_mm.collectors.scripted import ScriptedPolicy
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import SHIPPED
from marl_mm.envs import parallel_env
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.goal_env import GoalEnv
from marl_mm.envs.registry import TASKS, fewest_steps, make_task
from marl_mm.envs.rollout import EpisodePlan, run_episode
from marl_mm.envs.task import ScriptConfig
from marl_mm.envs.tasks.grasp import LAYOUT as HANDLING
from marl_mm.envs.tasks.reach import Reach
from marl_mm.episode import INFO
from marl_mm.errors import UsageError
from marl_mm.robot.names import ARM_LINKS, FINGER_LINKS, HAND_LINK
from marl_mm.sim.bullet.engine import pybullet
from marl_mm.sim.bullet.world import BulletWorld
from marl_mm.sim.config import SimulationConfig

REACHING = [name for name, task in TASKS.items() if isinstance(task, Reach)]

OpenWorld = Callable[..., EpisodeCore]

Act = Callable[[np.ndarray], np.ndarray]

QUICK = {"ticks_per_step": 24}
"""A tenth of a second per step: the interface is the same, the tests faster."""

SHORT = {"max_steps": 4}
"""Whole seconds, few of them."""

TAKEN = {"max_steps": 7}
"""Enough for the script to take a block."""

EPISODES = 2


def busy_actions(task: str, seed: int) -> tuple[dict[str, int], Act]:
    """Steps per episode, and what acts on a joint state: at random.

    Where a block is to be taken, it is the script: random actions would soon miss it.
    """
    layout = make_task(task).layout
    if layout == HANDLING:
        return TAKEN, ScriptedPolicy(ScriptConfig(), make_task(task)).act
    rng = np.random.default_rng(seed)
    return SHORT, lambda _: rng.uniform(layout.low, layout.high).astype(np.float32)


ARM = {*ARM_LINKS, HAND_LINK, *FINGER_LINKS}


def contents(core: EpisodeCore) -> tuple[int, set[str], int]:
    """Bodies in a world, links of its robot that can touch, the solver's iterations."""
    if not isinstance(core.drive.world, BulletWorld):
        pytest.skip("not on PyBullet")
    client = {"physicsClientId": core.drive.world.client}
    robot = 1  # after the ground
    links = {
        pybullet.getJointInfo(robot, number, **client)[12].decode(): number
        for number in range(pybullet.getNumJoints(robot, **client))
    }
    solid = {
        name
        for name, number in links.items()
        if pybullet.getCollisionShapeData(robot, number, **client)
    }
    parameters = pybullet.getPhysicsEngineParameters(**client)
    bodies = pybullet.getNumBodies(**client)
    return bodies, solid, parameters["numSolverIterations"]


def agents_hash(seed: int, task: str) -> str:
    """Hash of all that a parallel env returns over full episodes."""
    overrides, act = busy_actions(task, seed)
    env = parallel_env(task, overrides=overrides)
    agents = make_task(task).layout.agents
    digest = hashlib.sha256()
    for episode in range(EPISODES):
        observations, _ = env.reset(seed=seed if episode == 0 else None)
        while env.agents:
            joint = act(env.state())
            actions = {agent.name: joint[list(agent.action)] for agent in agents}
            observations, rewards, *_, infos = env.step(actions)
            digest.update(env.state().tobytes())
            for name, observation in observations.items():
                digest.update(observation.tobytes())
                digest.update(repr([rewards[name], infos[name]]).encode())
    env.close()
    return digest.hexdigest()


def trajectory_hash(seed: int, task: str) -> str:
    """Hash of all that an env returns over full episodes."""
    overrides, act = busy_actions(task, seed)
    env = gymnasium.make(f"marl_mm/{task}", overrides=overrides)
    digest = hashlib.sha256()
    for episode in range(EPISODES):
        observation, _ = env.reset(seed=seed if episode == 0 else None)
        ended = False
        while not ended:
            parts = [observation["observation"], observation["desired_goal"]]
            action = act(np.concatenate(parts))
            observation, reward, terminated, truncated, info = env.step(action)
            ended = terminated or truncated
            for key in sorted(observation):
                digest.update(observation[key].tobytes())
            digest.update(repr([float(reward), info]).encode())
    env.close()
    return digest.hexdigest()


def test_every_task_is_registered_and_nothing_else() -> None:
    found = {name for name in gymnasium.registry if name.startswith("marl_mm/")}
    assert found == {f"marl_mm/{task}" for task in TASKS.names()}


@pytest.mark.parametrize("task", REACHING)
def test_gymnasium_check_env(task: str) -> None:
    env = gymnasium.make(f"marl_mm/{task}", overrides=QUICK, disable_env_checker=True)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*infinity.*")
        check_env(env.unwrapped)
    env.close()


@pytest.mark.parametrize("task", REACHING)
def test_pettingzoo_parallel_api(task: str) -> None:
    env = parallel_env(task, overrides=QUICK)
    parallel_api_test(env, num_cycles=60)
    env.close()


@pytest.mark.parametrize("task", REACHING)
def test_pettingzoo_parallel_seed(task: str) -> None:
    parallel_seed_test(lambda: parallel_env(task, overrides=QUICK))


def hashes(seed: int, task: str) -> str:
    """Those of both interfaces."""
    return f"{trajectory_hash(seed, task)} {agents_hash(seed, task)}"


@pytest.fixture(scope="module")
def elsewhere() -> dict[str, str]:
    """Hashes of all tasks, each with seed 3, in another process."""
    code = (
        "import importlib.util as u;"
        f"s = u.spec_from_file_location('t', {__file__!r});"
        "m = u.module_from_spec(s); s.loader.exec_module(m);"
        "print(*(m.hashes(3, task) for task in m.REACHING), sep='\\n')"
    )
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return dict(zip(REACHING, output.stdout.splitlines(), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("task", REACHING)
def test_same_seed_same_bytes_twice_in_a_process_and_in_another(
    task: str, elsewhere: dict[str, str]
) -> None:
    first = hashes(3, task)
    busy = EpisodeCore(TASKS.get("Reach-v0"))  # whatever ran before must not matter
    busy.reset(np.random.default_rng(9))
    busy.step(np.array([1.0, -1.0, 0.5, 0.0]))
    again = hashes(3, task)
    busy.close()
    assert first == again == elsewhere[task]
    with closing(parallel_env(task)) as env:
        starts = set()
        for seed in (3, 4):
            env.reset(seed=seed)
            starts.add(env.state().tobytes())
    assert len(starts) == 2


@pytest.mark.slow
@pytest.mark.bullet
def test_an_empty_world_is_as_it_was_before_there_were_blocks() -> None:
    """The dataset that ships is older; to the last bit where processors round alike."""
    dataset = load_dataset(SHIPPED)
    core = EpisodeCore(make_task("Reach-v0"))
    for number in (0, 1, 50):
        episode = dataset.arrays.episode(number)
        plan = EpisodePlan(episode.index, episode.seed)
        again = run_episode(core, ReplayPolicy(episode), plan)
        np.testing.assert_allclose(again.states, episode.states, rtol=0, atol=1e-9)
        np.testing.assert_allclose(again.rewards, episode.rewards, rtol=0, atol=1e-9)
    core.close()


def test_an_empty_world_has_nothing_of_a_block_to_spend_time_on(
    open_world: OpenWorld,
) -> None:
    """No hand that looks, no body but robot and ground, no solid arm that could touch
    anything, and no more iterations of the solver."""
    core = open_world("Reach-v0")
    core.reset(np.random.default_rng(0))
    assert core.drive.hand is None
    bodies, solid, iterations = contents(core)
    assert bodies == 2
    assert not solid & ARM
    assert iterations == SimulationConfig().solver_iterations

    core = open_world("CarryReach-v0")
    core.reset(np.random.default_rng(0))
    assert core.drive.hand is not None
    bodies, solid, iterations = contents(core)
    assert bodies == 3
    assert solid >= ARM - {ARM_LINKS[0]}  # which is within the base
    assert iterations == SimulationConfig().grasp_iterations


@pytest.mark.slow
@pytest.mark.parametrize(
    "task",  # levels are the same with other numbers
    [t for t, task in TASKS.items() if task.fails and t.count("-") == 1],
)
def test_an_episode_does_not_depend_on_the_one_before(
    task: str, open_world: OpenWorld
) -> None:
    steps = fewest_steps(task, 8)  # the script takes a block in 7
    fresh, used = open_world(task, steps), open_world(task, steps)
    script, plan = ScriptedPolicy(ScriptConfig(), make_task(task)), EpisodePlan(0, 1)
    run_episode(used, script, EpisodePlan(1, 5))  # of a block it ends with it in hand
    np.testing.assert_array_equal(
        run_episode(used, script, plan).states, run_episode(fresh, script, plan).states
    )


@pytest.mark.parametrize("task", REACHING)
def test_both_interfaces_tell_the_same_story(task: str) -> None:
    """One core: same seed and joint action, same state and reward."""
    goal_env = GoalEnv(task, overrides=QUICK)
    agents_env = parallel_env(task, overrides=QUICK)
    layout = goal_env.core.task.layout
    low, high = layout.low, layout.high
    goal, _ = goal_env.reset(seed=5)
    agents, _ = agents_env.reset(seed=5)
    rng = np.random.default_rng(0)
    for _ in range(3):
        state = agents_env.state()
        expected = np.concatenate([goal["observation"], goal["desired_goal"]])
        np.testing.assert_array_equal(state, expected)
        np.testing.assert_array_equal(goal["achieved_goal"], state[layout.achieved])
        for agent in layout.agents:
            own = state[list(agent.observation)]
            np.testing.assert_array_equal(agents[agent.name], own)
        action = rng.uniform(low, high)
        goal, reward, *_ = goal_env.step(action)
        agents, rewards, *_ = agents_env.step(
            {"end_effector": action[:-1], "balance": action[-1:]}
        )
        assert rewards == {"end_effector": reward, "balance": reward}
    goal_env.close()
    agents_env.close()


@pytest.mark.parametrize("task", REACHING)
def test_compute_reward_repeats_the_steps_reward(task: str) -> None:
    env = GoalEnv(task, overrides=QUICK)
    env.reset(seed=0)
    observations, rewards, infos = [], [], []
    for _ in range(3):
        observation, reward, _, _, info = env.step(env.action_space.sample())
        observations.append(observation)
        rewards.append(reward)
        infos.append(info)
    achieved = np.stack([o["achieved_goal"] for o in observations])
    desired = np.stack([o["desired_goal"] for o in observations])
    np.testing.assert_array_equal(env.compute_reward(achieved, desired, infos), rewards)
    single = env.compute_reward(achieved[0], desired[0], infos[0])
    assert single == rewards[0]
    handling = env.core.task.layout is HANDLING  # only what is held reaches a goal
    assert env.compute_terminated(achieved, achieved, infos).all() != handling
    assert not env.compute_truncated(achieved, desired, infos).any()
    env.close()


@pytest.mark.parametrize("task", REACHING)
def test_reaching_terminates_and_time_truncates(task: str) -> None:
    load = {"load": {"hold_ticks": 24}} if TASKS.get(task).layout is HANDLING else {}
    env = GoalEnv(task, overrides={**QUICK, **load, "max_steps": 2})
    still = np.zeros(len(env.core.task.layout.action), np.float32)
    still[env.core.task.layout.action_names.index("alpha")] = 1.0
    if env.core.task.layout is HANDLING:
        still[3] = -1.0
    else:
        observation, _ = env.reset(seed=0)
        env.reset(seed=0, options={"goal": observation["achieved_goal"]})
        *_, terminated, truncated, info = env.step(still)
        assert (terminated, truncated, info["is_success"]) == (True, False, True)
    env.reset(seed=0)
    ends = [env.step(still)[2:4] for _ in range(2)]
    assert ends == [(False, False), (False, True)]
    with pytest.warns(UserWarning, match="after the episode's end: call reset"):
        env.step(still)
    env.close()


def test_the_hand_goes_where_the_action_says(core: EpisodeCore) -> None:
    """One full step of (1, 0.5, -0.5): 10, 5 and -5 cm, to 1 cm."""
    state = core.reset(np.random.default_rng(0))
    step = core.step(np.array([1.0, 0.5, -0.5, 1.0]))
    np.testing.assert_allclose(
        step.state[:3] - state[:3], (0.1, 0.05, -0.05), atol=0.01
    )
    assert step.info["d_mm"] < 0.01


def test_a_switch_can_be_overridden_and_nothing_else_is_one() -> None:
    config = make_task("Reach-v0", {"controller": {"limits": {"zmp": True}}})
    assert config.controller.limits.zmp is True
    for wrong in ({"zmp": 1}, {"traction": True}):
        with pytest.raises(UsageError, match=r"controller\.limits\."):
            make_task("Reach-v0", {"controller": {"limits": wrong}})


def test_the_zmp_limit_keeps_a_top_heavy_robot_from_tipping() -> None:
    margins = {}
    for zmp in (False, True):
        limits = {"controller": {"limits": {"zmp": zmp, "zmp_margin": 0.15}}}
        robot = {"robot": {"base_mass": 40.0, "base_com_b": (0.0, 0.0, 0.45)}}
        core = EpisodeCore(make_task("Reach-v0", {**limits, **robot}))
        core.reset(np.random.default_rng(0))
        infos = [core.step(np.array([x, 0.0, 0.0, 0.0])).info for x in (1.0, -1.0)]
        core.close()
        assert all(info["qp_failures"] == 0 for info in infos)
        margins[zmp] = min(info["zmp_margin"] for info in infos)
    assert margins[False] < 0.13 and margins[True] > 0.15 - 1e-9


@pytest.mark.parametrize("task", REACHING)
def test_info_is_what_its_list_says_and_plausible(
    task: str, open_world: OpenWorld
) -> None:
    """At rest: upright, on its wheels, the model where the simulator is."""
    core = open_world(task)
    core.reset(np.random.default_rng(0))
    still = np.zeros(len(core.task.layout.action))
    still[-1] = 1.0  # alpha
    info = core.step(still).info
    of_a_block = ["held", "reason"] if TASKS.get(task).fails else []
    assert list(info) == [*INFO, *of_a_block]
    assert 0.1 < info["zmp_margin"] < 0.25
    assert 0 <= abs(info["base_pitch"]) <= info["tilt"] < 1e-3
    assert 0 <= info["wheel_slip"] < 0.01
    assert 0 <= info["model_ee_error"] < 1e-3
    assert info["qp_failures"] == info["safe_ticks"] == 0


def test_alpha_decides_who_waits(core: EpisodeCore) -> None:
    """Backwards, a stable base leaves the hand behind; an accurate hand, the base."""
    errors = {}
    for alpha in (0.0, 1.0):
        core.reset(np.random.default_rng(0), np.array([-0.7, 0.0, 0.6]))
        infos = [core.step(np.array([-1.0, 0, 0, alpha])).info for _ in range(8)]
        errors[alpha] = {k: np.mean([i[k] for i in infos]) for k in ("d_mm", "d_mp")}
    assert errors[0.0]["d_mm"] < 0.1 * errors[1.0]["d_mm"]
    assert errors[1.0]["d_mp"] < 0.1 * errors[0.0]["d_mp"]


class Broken(Reach):
    """Every step fails."""

    def failure(self, attempt: Any) -> str:
        return "broken"


@pytest.mark.parametrize("kind", [Reach, Broken])
def test_an_episode_ends_in_one_way(kind: type[Reach]) -> None:
    """Here at its goal in the last step: not cut off, nor reached if it failed."""
    simulation = SimulationConfig(engine="mujoco")
    with closing(EpisodeCore(kind(max_steps=1, simulation=simulation))) as core:
        rng = np.random.default_rng(0)
        hand = core.reset(rng)[core.task.layout.achieved]
        core.reset(rng, hand)
        step = core.step(np.array([0.0, 0.0, 0.0, 1.0]))
    assert step.info["distance"] < 0.05
    assert step.terminated and not step.truncated
    assert step.info["is_success"] == (kind is Reach)
    assert step.info.get("reason", "") == ("broken" if kind is Broken else "")
