"""Time in which a team acts: the policies of all offline learners."""

from time import perf_counter

import numpy as np

from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.registry import names
from marl_mm.algorithms.speed import small_networks
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.envs.registry import make_task
from marl_mm.eval.bench.matched import learner, with_settings
from marl_mm.progress import Advance, silent


@small_networks()
def bench_acting(
    hidden: tuple[int, ...], seed: int, calls: int = 400, advance: Advance = silent
) -> dict[str, dict[str, float]]:
    """Time of a joint action on one core, by learner [ms].

    A plan of several actions counts in the call that makes it.

    Args:
        hidden: Units of the hidden layers.
        seed: Seed of weights and noise.
        calls: Number of timed actions of each learner.
        advance: Called with the number of learners that are done.

    Returns:
        Median and 99th percentile.
    """
    arrays, task = shipped_arrays(), make_task()
    state, times = np.zeros(len(task.layout.state), np.float32), np.empty(calls)
    result = {}
    for name in names(online=False):
        config = with_settings(name, {"hidden": hidden})
        agents = learner(name, config, arrays, task, seed).agents(0)
        policy = LearnedPolicy(name, agents, task.layout)
        policy.begin(np.random.default_rng(seed), task.layout)
        policy.act(state)
        for number in range(calls):
            begun = perf_counter()
            policy.act(state)
            times[number] = 1e3 * (perf_counter() - begun)
        median, longest = np.quantile(times, (0.5, 0.99)).tolist()
        result[name] = {"median": median, "p99": longest}
        advance(1, name)
    return result
