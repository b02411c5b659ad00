"""Speed of an environment: engines in turns, and a vector against a single one."""

from collections.abc import Callable, Sequence
from time import perf_counter, process_time
from typing import Any

import numpy as np

from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import make_task
from marl_mm.envs.vector import TaskVector
from marl_mm.errors import UsageError
from marl_mm.progress import Bar
from marl_mm.sim.config import Engine, engine_overrides

REFERENCE: Engine = "bullet"
"""Engine that the others' speeds are divided by."""

ALPHAS: dict[str, float | None] = {"random alpha": None, "alpha 1": 1.0}
"""Alphas of the actions; None draws one for each step."""


def bench_env(
    task: str,
    engines: Sequence[Engine],
    turns: int,
    steps: int,
    seed: int,
    vector: int,
    workers: int,
    bar: Bar,
) -> dict[str, Any]:
    """Environment steps per second of CPU time of engines that take turns.

    They run in one process; CPU time does not count what others do meanwhile. An engine
    with a compiled step is timed with the loop in Python, too, which a watch of every
    tick asks for. A vector of environments takes turns with a single one, in time as a
    clock on the wall shows it.

    Args:
        task: Registered name of the task.
        engines: Engines to compare; PyBullet is their reference if it is among them.
        turns: Number of turns of each.
        steps: Environment steps of a turn, with random actions.
        seed: Seed of goals and actions.
        vector: Number of environments of the vector.
        workers: Number of its threads or processes.
        bar: Factory of progress bars.

    Raises:
        UsageError: If there are no engines, or one twice.
    """
    check_engines(engines)
    kinds: dict[str, tuple[EpisodeCore, Any]] = {}
    for engine in engines:
        core = EpisodeCore(make_task(task, engine_overrides(engine)))
        kinds[engine] = core, None
        if core.drive.world.native:
            kinds[f"{engine}, loop in Python"] = core, lambda tick: None
    advance = bar("bench env", turns * len(kinds) * len(ALPHAS))
    speeds: dict[str, dict[str, list[float]]] = {
        alpha: {kind: [] for kind in kinds} for alpha in ALPHAS
    }
    for turn in range(-1, turns):  # the first compiles
        for label, alpha in ALPHAS.items():
            for kind, (core, watch) in kinds.items():
                rng = np.random.default_rng([seed, max(turn, 0)])
                seconds = timed(core, rng, steps, alpha, watch)
                if turn >= 0:
                    speeds[label][kind].append(steps / seconds)
                    advance(1, kind)
    result: dict[str, Any] = {}
    for label, by_kind in speeds.items():
        medians = {kind: float(np.median(values)) for kind, values in by_kind.items()}
        result[f"{label}: steps/s"] = medians
        if REFERENCE in engines and len(kinds) > 1:
            result[f"{label}: times the steps/s of {REFERENCE}"] = {
                kind: float(np.median(np.divide(values, by_kind[REFERENCE])))
                for kind, values in by_kind.items()
                if kind != REFERENCE
            }
    for engine in engines:
        core, _ = kinds[engine]
        if core.drive.world.native:
            # It needs the library of such an engine.
            from marl_mm.eval.bench.step_parts import step_parts

            result[f"{engine}: us of a tick"] = step_parts(core, medians[engine])
        core.close()
    label = f"vector of {vector}, {workers} workers: times the steps/s of one"
    result[label] = {
        engine: _speed_up(task, engine, turns, steps, seed, vector, workers)
        for engine in engines
    }
    return result


def check_engines(engines: Sequence[str]) -> None:
    """Refuse no engines, and one twice."""
    if not engines or len({*engines}) < len(engines):
        text = ", ".join(engines) or "none"
        raise UsageError(f"engines are {text}, expected each at most once, and one")


def _speed_up(
    task: str,
    engine: Engine,
    turns: int,
    steps: int,
    seed: int,
    vector: int,
    workers: int,
) -> float:
    """Times the steps per second of one environment, with the resets that fall due."""
    overrides = engine_overrides(engine)
    single = TaskVector(task, 1, 1, overrides)
    many = TaskVector(task, vector, workers, overrides)
    ratios = []
    for turn in range(-1, turns):  # the first warms up
        times = []
        rounds = max(1, 16 * steps // vector)
        for envs, count in ((single, 4 * steps), (many, rounds)):  # a turn is short
            envs.reset(seed=seed + max(turn, 0))
            envs.action_space.seed(seed + max(turn, 0))
            begun = perf_counter()
            for _ in range(count):
                envs.step(envs.action_space.sample())
            times.append((perf_counter() - begun) / count / envs.num_envs)
        if turn >= 0:
            ratios.append(times[0] / times[1])
    single.close()
    many.close()
    return float(np.median(ratios))


def timed(
    core: EpisodeCore,
    rng: np.random.Generator,
    steps: int,
    alpha: float | None = None,
    watch: Callable[[Any], None] | None = None,
) -> float:
    """CPU time of some steps with random actions [s]; resets are not counted.

    Args:
        core: The environment.
        rng: Stream of episodes and actions.
        steps: Number of steps.
        alpha: Alpha of all actions and robots; None: random, too.
        watch: Function that is called after each tick, in the loop in Python.
    """
    low, high = np.array(core.task.layout.low), np.array(core.task.layout.high)
    seconds, left = 0.0, 0
    for _ in range(steps):
        if not left:
            core.reset(rng)
            left = core.task.max_steps
        action = rng.uniform(low, high)
        if alpha is not None:
            names = core.task.layout.action_names
            action[[name.endswith("alpha") for name in names]] = alpha
        begun = process_time()
        step = core.step(action, watch)
        seconds += process_time() - begun
        left = 0 if step.terminated else left - 1
    return seconds
