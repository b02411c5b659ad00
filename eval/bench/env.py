"""Speed of an environment: engines in turns, and where the time of a step goes."""

from collections.abc import Callable, Sequence
from time import perf_counter, process_time
from typing import Any

import numpy as np

from marl_mm.control.compiled.tick import tick
from marl_mm.control.records import VARIABLES
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import make_task
from marl_mm.envs.vector import TaskVector
from marl_mm.jit import jit
from marl_mm.progress import Bar
from marl_mm.robot.planar import PlanarModel, planar_terms
from marl_mm.sim.config import RATE, Engine, engine_overrides
from marl_mm.sim.native import advance, read

REFERENCE: Engine = "bullet"
"""Engine that the others' speeds are divided by."""

ALPHAS: dict[str, float | None] = {"random alpha": None, "alpha 1": 1.0}
"""Alphas of the actions; None draws one for each step."""

_REPEATS = 200
"""Number of calls of a compiled part that are timed at once."""

_STEPS = 20
"""Number of steps, or of rounds of calls, of which the median time is a part's."""


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
    """
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
        if isinstance(core.drive.model, PlanarModel):
            result[f"{engine}: us of a tick"] = _parts(core, medians[engine])
        core.close()
    label = f"vector of {vector}, {workers} workers: times the steps/s of one"
    result[label] = {
        engine: _speed_up(task, engine, turns, steps, seed, vector, workers)
        for engine in engines
    }
    return result


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


def _parts(core: EpisodeCore, steps_per_second: float) -> dict[str, float]:
    """Times of a compiled tick's parts at the present state, alpha 1 [us].

    Args:
        core: Environment with a compiled step; its episode is over afterwards.
        steps_per_second: Its speed.
    """
    core.reset(np.random.default_rng(0))
    drive, model = core.drive, core.drive.model
    native, controller = drive.world.native, drive.controller
    assert native and isinstance(model, PlanarModel)
    terms = tuple(model.evaluate(drive.state))
    posture = drive.state.q[4:].copy()
    reference = terms[0] + 0.05, terms[1], drive.state.q[:2].copy(), 0.0, 0.03, posture
    parts = {
        "engine": _call_time(_repeat_engine, native),
        "model": _call_time(
            _repeat_model, *drive.state, model.bodies, model.scratch, model.terms
        ),
        "controller": _call_time(
            _repeat_controller,
            tuple(drive.state),
            terms,
            reference,
            controller.numbers,
            *controller.priorities(1.0),
            controller.rows,
            np.empty(VARIABLES),
            np.empty(7),
            np.zeros(4, np.int64),
        ),
        "reading": _call_time(_repeat_reading, native, *drive.state),
        "Python around a step": _around(core) / core.task.ticks_per_step,
    }
    whole = 1e6 / steps_per_second / core.task.ticks_per_step
    return {"all": whole, **parts, "the rest": whole - sum(parts.values())}


def _around(core: EpisodeCore) -> float:
    """Median time of a step without its ticks [us]."""
    attempt = core.attempt
    assert attempt is not None
    follow, times = attempt.follow, list[float]()

    def timed(*arguments: Any) -> Any:
        begun = process_time()
        motions = follow(*arguments)
        times[-1] -= process_time() - begun
        return motions

    attempt.follow = timed  # type: ignore[assignment, method-assign]
    action = np.zeros(len(core.task.layout.action_names))
    for _ in range(_STEPS):
        times.append(0.0)
        begun = process_time()
        core.step(action)
        times[-1] += process_time() - begun
    return 1e6 * float(np.median(times))


def _call_time(repeat: Callable[..., None], *arguments: Any) -> float:
    """Median CPU time of one of many calls in compiled code [us]."""
    repeat(1, *arguments)  # compiles
    times = []
    for _ in range(_STEPS):
        begun = process_time()
        repeat(_REPEATS, *arguments)
        times.append(1e6 * (process_time() - begun) / _REPEATS)
    return float(np.median(times))


@jit
def _repeat_model(
    repeats: int, q: np.ndarray, v: np.ndarray, bodies: Any, scratch: Any, terms: Any
) -> None:
    for _ in range(repeats):
        planar_terms(q, v, bodies, scratch, terms)


@jit
def _repeat_engine(repeats: int, native: Any) -> None:
    for _ in range(repeats):
        advance(native, 0.0, 0.0)


@jit
def _repeat_reading(repeats: int, native: Any, q: np.ndarray, v: np.ndarray) -> None:
    for _ in range(repeats):
        read(native, q, v)


@jit
def _repeat_controller(
    repeats: int,
    state: Any,
    terms: Any,
    reference: Any,
    numbers: Any,
    matrices: np.ndarray,
    shares: np.ndarray,
    rows: int,
    u: np.ndarray,
    torque: np.ndarray,
    counters: np.ndarray,
) -> None:
    robot, gains, hierarchy, limits = numbers
    for _ in range(repeats):
        tick(
            state,
            terms,
            reference,
            robot,
            gains,
            hierarchy,
            limits,
            matrices,
            shares,
            rows,
            float(RATE),
            u,
            torque,
            counters,
        )
