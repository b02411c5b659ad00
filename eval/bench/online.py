"""Online learning beside Stable-Baselines3's: updates per second, success by steps.

For the updates, both learn from as many random episodes of the same task, with the same
batch, hidden layers and hindsight, and take turns, so that a noisy machine is as noisy
for both. Ours does more in an update: its critic's layers are normalised; it is timed
without that, too.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from marl_mm.algorithms.ddpg import Ddpg
from marl_mm.algorithms.ddpg_config import DdpgConfig
from marl_mm.algorithms.maddpg import Maddpg
from marl_mm.algorithms.maddpg_config import MaddpgConfig
from marl_mm.algorithms.online import run_cycle
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.registry import preset
from marl_mm.algorithms.speed import small_networks
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import EpisodePlan, Rollouts, episode_seed
from marl_mm.envs.task import Task
from marl_mm.eval.bench import SB3
from marl_mm.eval.evaluate import evaluate_with
from marl_mm.policy import Policy
from marl_mm.progress import Advance, silent

TASK = "Reach-v0"

_TURN = 100
"""Updates until it is the other's turn."""


@small_networks()
def bench_online(
    updates: int,
    seed: int = 0,
    sb3: bool = True,
    episodes: int = 40,
    advance: Advance = silent,
) -> dict[str, Any]:
    """Updates per second of each learner, and ours over SB3's.

    Args:
        updates: Number of updates of each algorithm, in turns.
        seed: Seed of networks and episodes.
        sb3: Whether to time Stable-Baselines3 too.
        episodes: Number of random episodes in the replays.
        advance: Called with the number of finished updates.
    """
    learners = _learners(seed, sb3, episodes, advance)
    rates: dict[str, list[float]] = {name: [] for name in learners}
    for turn in range(-1, max(1, updates // _TURN)):
        for name, learn in learners.items():
            begin = perf_counter()
            learn(_TURN)
            rate = _TURN / (perf_counter() - begin)
            if turn >= 0:  # the first one warms caches
                rates[name].append(rate)
                advance(_TURN, name)
    medians = {name: float(np.median(values)) for name, values in rates.items()}
    result: dict[str, Any] = {"updates_per_second": medians}
    names = [name for name in rates if name != SB3]
    if not sb3:
        result["sb3"] = "not installed: pip install -e '.[bench]'"
        return result
    for name in names:
        ratios = np.array(rates[name]) / np.array(rates[SB3])
        result[f"{name}_over_sb3"] = float(np.median(ratios))
    return result


def _learners(
    seed: int, sb3: bool, episodes: int, advance: Advance
) -> dict[str, Callable[[int], object]]:
    """Functions that make updates of each algorithm, after random episodes."""
    config = make_task(TASK)
    layout = config.layout
    plain = replace(preset("ddpg-her"), layer_norm=False)
    algorithms = {
        "ddpg-her": Ddpg(preset("ddpg-her"), config, seed, (), layout),
        "ddpg-her-no-layer-norm": Ddpg(plain, config, seed, (), layout),
        "maddpg-her": _maddpg(config, seed),
    }
    plans = [EpisodePlan(i, episode_seed(seed, i, "train")) for i in range(episodes)]
    explorer = Ddpg(
        replace(preset("ddpg-her"), warm_up=10**4), config, seed, (), layout
    )
    advance(0, "random episodes")
    with Rollouts(config) as rollouts:
        for episode in rollouts.run(explorer.behaviour(), plans):
            for algorithm in algorithms.values():
                algorithm.observe(episode)
    learners: dict[str, Callable[[int], object]] = {
        name: algorithm.learn for name, algorithm in algorithms.items()
    }
    return learners | ({SB3: _sb3(seed, episodes)} if sb3 else {})


@small_networks()
def bench_success(
    env_steps: int,
    seed: int = 0,
    goals: int = 100,
    sb3: bool = True,
    advance: Advance = silent,
) -> dict[str, Any]:
    """Success after training from nothing for so many steps of the environment.

    Args:
        env_steps: Environment steps of each learner; the last episodes are whole.
        seed: Seed of networks and episodes.
        goals: Number of goals of the evaluation, half ahead.
        sb3: Whether to train Stable-Baselines3 too.
        advance: Called with the number of finished environment steps.

    Returns:
        Success rate and its 95 % interval over the goals, by name.
    """
    hyper = preset("ddpg-her")
    success: dict[str, Any] = {}
    with Rollouts(make_task(TASK)) as rollouts:

        def measure(policy: Policy) -> dict[str, Any]:
            everything = evaluate_with(rollouts, policy, goals, seed, TASK).summary
            return {key: everything["all"][key] for key in ("success_rate", "interval")}

        ddpg = _taught(rollouts, hyper, env_steps, seed, advance)
        success[ddpg.name] = measure(LearnedPolicy(ddpg.name, ddpg.agents, ddpg.layout))
        if sb3:
            success[SB3] = measure(_sb3_taught(hyper, env_steps, seed, advance))
    return success


def _taught(
    rollouts: Rollouts, hyper: DdpgConfig, env_steps: int, seed: int, advance: Advance
) -> Ddpg:
    """Our learner, after so many steps."""
    run_episodes = partial(rollouts.train, seed)
    task = make_task(TASK)
    learner = Ddpg(hyper, task, seed, (), task.layout)
    while learner.env_steps < env_steps:
        episodes, _ = run_cycle(learner, run_episodes, hyper.episodes)
        advance(sum(map(len, episodes)), learner.name)
    return learner


def _sb3_taught(
    hyper: DdpgConfig, env_steps: int, seed: int, advance: Advance
) -> Policy:
    """Stable-Baselines3's policy, after so many steps."""
    from marl_mm.eval.bench.sb3_reference import Sb3Policy, learn_sb3, sb3_model

    model, counted = sb3_model(TASK, hyper, seed), 0

    def look(episode: int, steps: int) -> bool:
        nonlocal counted
        advance(steps - counted, SB3)
        counted = steps
        return steps < env_steps

    learn_sb3(model, look)
    return Sb3Policy(model)


def _maddpg(task: Task, seed: int) -> Maddpg:
    config = preset("maddpg-her")
    assert isinstance(config, MaddpgConfig)
    return Maddpg(config, task, seed, (), task.layout)


def _sb3(seed: int, episodes: int) -> Any:
    from stable_baselines3.common.logger import configure

    from marl_mm.eval.bench.sb3_reference import sb3_model

    config = preset("ddpg-her")
    model = sb3_model(TASK, replace(config, warm_up=config.capacity), seed)
    model.set_logger(configure(None, []))
    model.learn(total_timesteps=25 * episodes)
    return partial(model.train, batch_size=config.batch_size)
