"""Time and episodes in which online learners reach most goals, engines in turns."""

from collections.abc import Sequence
from functools import partial
from time import perf_counter
from typing import Any

from marl_mm.algorithms.online import OnlineAlgorithm, run_cycle
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.registry import ALGORITHMS, preset
from marl_mm.algorithms.schedule import Schedule
from marl_mm.algorithms.speed import small_networks
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.errors import UsageError
from marl_mm.eval.bench.env import check_engines
from marl_mm.eval.evaluate import evaluate_with
from marl_mm.progress import Advance, Bar
from marl_mm.sim.config import Engine, engine_overrides

RATE = 0.95
"""Success rate to reach, at one of the evaluations of training."""

GOALS = 50, 1
"""Number of goals of an evaluation, and their seed: those of training by default."""


@small_networks()
def bench_learning(
    task: str,
    algorithms: Sequence[str],
    engines: Sequence[Engine],
    seeds: Sequence[int],
    workers: int,
    bar: Bar,
) -> dict[str, Any]:
    """Episodes and seconds to a success rate of 0.95, by algorithm and engine.

    Those per episode compare the engines' speed whatever the luck of their seeds.
    Seconds begin with the environments and count evaluations, as training does.

    Args:
        task: Registered name of the task.
        algorithms: Registered names of online algorithms, with their tuned presets.
        engines: Engines to compare; the first is the others' reference.
        seeds: Seeds of the runs.
        workers: Number of workers that run episodes.
        bar: Factory of progress bars.

    Raises:
        UsageError: If an algorithm learns from a dataset; if there are no engines, or
            one twice.
    """
    check_engines(engines)
    for name in algorithms:
        if not ALGORITHMS.get(name).online:
            online = [
                each for each in ALGORITHMS.names() if ALGORITHMS.get(each).online
            ]
            raise UsageError(
                f"{name} learns from a dataset, expected one of {', '.join(online)}"
            )
    result: dict[str, Any] = {}
    for algorithm in algorithms:
        seconds: dict[str, list[float]] = {engine: [] for engine in engines}
        episodes: dict[str, list[int]] = {engine: [] for engine in engines}
        for seed in seeds:
            for engine in engines:
                label = f"{algorithm} {seed} {engine}"
                advance = bar(label, preset(algorithm).episodes)
                begun = perf_counter()
                number = _learn(task, algorithm, engine, seed, workers, advance)
                seconds[engine].append(perf_counter() - begun)
                episodes[engine].append(number)
        result[f"{algorithm}: episodes to {RATE:.0%}"] = episodes
        result[f"{algorithm}: seconds"] = seconds
        sums = {
            e: (sum(seconds[e]), sum(seconds[e]) / sum(episodes[e])) for e in engines
        }
        for number, unit in enumerate(("seconds", "seconds an episode")):
            result[f"{algorithm}: times the {unit} of {engines[0]}"] = {
                engine: sums[engine][number] / sums[engines[0]][number]
                for engine in engines[1:]
            }
    return result


def _learn(
    task: str,
    algorithm: str,
    engine: Engine,
    seed: int,
    workers: int,
    advance: Advance,
) -> int:
    """Train as ``marl-mm train`` does; the number of episodes when it may stop."""
    overrides, schedule, config = (
        engine_overrides(engine),
        Schedule(),
        preset(algorithm),
    )
    judge = make_task(task, overrides)
    learner: OnlineAlgorithm = ALGORITHMS.get(algorithm).learner(
        config, judge, seed, (), judge.layout
    )
    with Rollouts(judge, workers) as rollouts:
        run = partial(rollouts.train, seed)
        while learner.episodes < config.episodes:
            end = learner.episodes + schedule.epoch * schedule.evaluate_every
            while learner.episodes < end:
                run_cycle(learner, run, end, advance)
            policy = LearnedPolicy(learner.name, learner.agents, learner.layout)
            evaluation = evaluate_with(rollouts, policy, *GOALS, task, overrides)
            if evaluation.success_rate >= RATE:
                break
    return learner.episodes
