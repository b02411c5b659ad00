"""Fixed goal sets, half ahead and half behind; or as the episodes' seeds draw them."""

import numpy as np

from marl_mm.envs.config import ReachConfig
from marl_mm.envs.rollout import EpisodePlan, episode_seed


def goal_set(config: ReachConfig, count: int, seed: int) -> list[EpisodePlan]:
    """Plans of ``count`` episodes whose goals alternate between ahead and behind.

    The first n goals of a seed are the same whatever ``count`` is. Where a block is to
    be lifted, that is the goal, and the plans have none.
    """
    if config.load is not None and config.load.lift:
        seeds = (episode_seed(seed, index, "evaluate") for index in range(count))
        return [EpisodePlan(index, own) for index, own in enumerate(seeds)]
    rng = np.random.default_rng(seed)
    plans = []
    for index in range(count):
        x = config.goal_x_backward if index % 2 else config.goal_x_forward
        goal = tuple(float(rng.uniform(*a)) for a in (x, config.goal_y, config.goal_z))
        plans.append(EpisodePlan(index, episode_seed(seed, index, "evaluate"), goal))  # type: ignore[arg-type]
    return plans
