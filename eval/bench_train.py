"""Online learning beside Stable-Baselines3's: updates per second, success by steps.

For the updates, both learn from as many random episodes of the same task, with the same
batch, hidden layers and hindsight, and take turns, so that a noisy machine is as noisy
for both. Ours does more in an update: its critic's layers are normalised.
"""

from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
import torch

from marl_mm.algorithms.ddpg import Ddpg
from marl_mm.algorithms.maddpg import Maddpg, MaddpgConfig
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.presets import preset
from marl_mm.envs.config import reach_config
from marl_mm.envs.rollout import EpisodePlan, Rollouts, episode_seed
from marl_mm.envs.terms import judge
from marl_mm.eval.evaluate import evaluate_with
from marl_mm.policy import Policy
from marl_mm.progress import Advance, silent

TASK = "Reach-v0"

_TURN = 100
"""Updates until it is the other's turn."""


def bench_train(
    updates: int,
    seed: int = 0,
    sb3: bool = True,
    episodes: int = 40,
    advance: Advance = silent,
) -> dict[str, Any]:
    """Updates per second of each, and ours over SB3's.

    Args:
        updates: Of each algorithm, in turns.
        seed: Of networks and episodes.
        sb3: Whether to time Stable-Baselines3, too.
        episodes: Random ones in the replays.
        advance: Told the updates.
    """
    torch.set_num_threads(1)
    config = reach_config(TASK)
    rewards = partial(judge, config=config)
    ours = {
        "ddpg-her": Ddpg(preset("ddpg-her"), rewards, seed),
        "maddpg-her": _maddpg(rewards, seed),
    }
    plans = [EpisodePlan(i, episode_seed(seed, i, "train")) for i in range(episodes)]
    explorer = Ddpg(replace(preset("ddpg-her"), warm_up=10**4), rewards, seed)
    advance(0, "random episodes")
    with Rollouts(config) as rollouts:
        for episode in rollouts.run(explorer.behaviour(), plans):
            for algorithm in ours.values():
                algorithm.observe(episode)
    learners = {name: algorithm.learn for name, algorithm in ours.items()}
    if sb3:
        learners["sb3-ddpg-her"] = _sb3(seed, episodes)
    rates: dict[str, list[float]] = {name: [] for name in learners}
    for turn in range(-1, max(1, updates // _TURN)):
        for name, learn in learners.items():
            begin = perf_counter()
            learn(_TURN)
            rate = _TURN / (perf_counter() - begin)
            if turn >= 0:  # the first one warms caches
                rates[name].append(rate)
        advance(_TURN if turn >= 0 else 0, "")
    medians = {name: float(np.median(values)) for name, values in rates.items()}
    result: dict[str, Any] = {"updates_per_second": medians}
    if not sb3:
        result["sb3"] = "not installed: pip install 'marl-mm[bench]'"
    if sb3:
        for name in ours:
            ratios = np.array(rates[name]) / np.array(rates["sb3-ddpg-her"])
            result[f"{name}_over_sb3"] = float(np.median(ratios))
    return result


def bench_success(
    env_steps: int,
    seed: int = 0,
    goals: int = 100,
    sb3: bool = True,
    advance: Advance = silent,
) -> dict[str, float]:
    """Success rate after training from nothing for so many steps of the environment.

    Args:
        env_steps: Of each; the last episode is whole.
        seed: Of networks and episodes.
        goals: Of the evaluation, half ahead.
        sb3: Whether to train Stable-Baselines3, too.
        advance: Told the environment's steps.
    """
    torch.set_num_threads(1)
    config = reach_config(TASK)
    hyper = preset("ddpg-her")
    ours = Ddpg(hyper, partial(judge, config=config), seed)
    success = {}
    with Rollouts(config) as rollouts:

        def rate(policy: Policy) -> float:
            return evaluate_with(rollouts, policy, goals, seed, TASK).success_rate

        while ours.env_steps < env_steps:
            first = ours.episodes
            plans = [
                EpisodePlan(i, episode_seed(seed, i, "train"))
                for i in range(first, first + hyper.episodes_per_cycle)
            ]
            for episode in rollouts.run(ours.behaviour(), plans):
                ours.observe(episode)
                advance(len(episode), ours.name)
            if ours.warm:
                ours.learn(hyper.updates_per_episode * len(plans))
        success[ours.name] = rate(LearnedPolicy(ours.name, ours.agents))
        if sb3:
            from marl_mm.eval.sb3_reference import NAME, Sb3Policy, learn_sb3, sb3_model

            model, told = sb3_model(TASK, hyper, seed), 0

            def look(episode: int, steps: int) -> bool:
                nonlocal told
                advance(steps - told, NAME)
                told = steps
                return steps < env_steps

            learn_sb3(model, look)
            success[NAME] = rate(Sb3Policy(model))
    return success


def _maddpg(rewards: Any, seed: int) -> Maddpg:
    config = preset("maddpg-her")
    assert isinstance(config, MaddpgConfig)
    return Maddpg(config, rewards, seed)


def _sb3(seed: int, episodes: int) -> Any:
    from stable_baselines3.common.logger import configure

    from marl_mm.eval.sb3_reference import sb3_model

    config = preset("ddpg-her")
    model = sb3_model(TASK, replace(config, warm_up=config.capacity), seed)
    model.set_logger(configure(None, []))
    model.learn(total_timesteps=25 * episodes)
    return partial(model.train, batch_size=config.batch_size)
