"""Fixed goal sets: the task's own, or as the episodes' seeds draw them."""

import numpy as np

from marl_mm.envs.rollout import EpisodePlan, episode_seed
from marl_mm.envs.task import Task


def goal_set(task: Task, count: int, seed: int) -> list[EpisodePlan]:
    """Plans of ``count`` episodes with the task's goals; see ``Task.fixed_goal``.

    The first n goals of a seed are the same whatever ``count`` is.
    """
    rng = np.random.default_rng(seed)
    return [
        EpisodePlan(
            index, episode_seed(seed, index, "evaluate"), task.fixed_goal(index, rng)
        )
        for index in range(count)
    ]
