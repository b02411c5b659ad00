"""Fixed goal sets, half ahead and half behind."""

import numpy as np

from marl_mm.envs.config import ReachConfig
from marl_mm.envs.rollout import EpisodePlan, episode_seed


def goal_set(config: ReachConfig, count: int, seed: int) -> list[EpisodePlan]:
    """Plans of ``count`` episodes whose goals alternate between ahead and behind.

    The first n goals of a seed are the same whatever ``count`` is.
    """
    rng = np.random.default_rng(seed)
    plans = []
    for index in range(count):
        x = config.goal_x_backward if index % 2 else config.goal_x_forward
        goal = tuple(float(rng.uniform(*a)) for a in (x, config.goal_y, config.goal_z))
        plans.append(EpisodePlan(index, episode_seed(seed, index, "evaluate"), goal))  # type: ignore[arg-type]
    return plans
