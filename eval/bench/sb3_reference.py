"""Stable-Baselines3's DDPG with hindsight on our task, to measure ours against.

Hidden layers, batch, rates and updates per episode are those of a ``DdpgConfig``; SB3
does without input statistics, layer norm, clipped targets and a penalty on actions. Of
relabelled transitions it recomputes the reward, but not whether they ended the episode.
The only import of Stable-Baselines3, which is optional (extra ``bench``).
"""

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3 import DDPG, HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise

from marl_mm.algorithms.ddpg_config import DdpgConfig
from marl_mm.envs.goal_env import goal_observation
from marl_mm.envs.tasks.reach import LAYOUT
from marl_mm.eval.bench import SB3
from marl_mm.layout import Layout


class Sb3Policy:
    """A model of SB3 behind the interface of every policy; deterministic."""

    name = SB3

    def __init__(self, model: DDPG) -> None:
        self._model = model

    def describe(self) -> dict[str, Any]:
        """Nothing: the run's config says it."""
        return {}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Nothing to remember between episodes."""
        self._layout = layout

    def act(self, state: np.ndarray) -> np.ndarray:
        """Joint action, shape (4,), float32."""
        observation = goal_observation(state, self._layout)
        action, _ = self._model.predict(observation, deterministic=True)
        return np.asarray(action, np.float32)


def sb3_model(
    task: str, config: DdpgConfig, seed: int, overrides: Mapping[str, Any] | None = None
) -> DDPG:
    """SB3's DDPG+HER with our hyper-parameters, on the CPU."""
    return DDPG(
        "MultiInputPolicy",
        gymnasium.make(f"marl_mm/{task}", overrides=overrides),
        learning_rate=config.actor_learning_rate,
        buffer_size=config.capacity,
        learning_starts=config.warm_up,
        batch_size=config.batch_size,
        tau=config.target_rate,
        gamma=config.discount,
        train_freq=(1, "episode"),
        gradient_steps=config.updates_per_episode,
        action_noise=NormalActionNoise(
            np.zeros(len(LAYOUT.action)), np.full(len(LAYOUT.action), config.noise)
        ),
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={
            "n_sampled_goal": config.hindsight,
            "goal_selection_strategy": "future",
            "copy_info_dict": True,  # the reward needs d_mm, d_mp and jerk
        },
        policy_kwargs={"net_arch": list(config.hidden)},
        seed=seed,
        device="cpu",
    )


def learn_sb3(model: DDPG, look: Callable[[int, int], bool]) -> None:
    """Train until a look at the model says that it is enough.

    Args:
        model: Model of ``sb3_model``.
        look: Callback after each episode and its updates, with the numbers of episodes
            and environment steps so far; returns whether to go on.
    """

    class Looking(BaseCallback):
        """Counts episodes; SB3 knows steps only."""

        episodes = looked = 0
        go_on = True

        def _on_step(self) -> bool:
            self.episodes += int(self.locals["dones"].sum())
            return self.go_on

        def _on_rollout_start(self) -> None:
            if self.episodes > self.looked:
                self.looked = self.episodes
                self.go_on = look(self.episodes, self.num_timesteps)

    model.learn(total_timesteps=10**9, callback=Looking())
