"""Where the time of a compiled step goes."""

from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np

from marl_mm.control.compiled.tick import tick
from marl_mm.control.records import VARIABLES
from marl_mm.envs.core import EpisodeCore
from marl_mm.jit import jit
from marl_mm.robot.planar import PlanarModel, planar_terms
from marl_mm.sim.config import RATE
from marl_mm.sim.mujoco.native import advance, read

_REPEATS = 200
"""Number of calls of a compiled part that are timed at once."""

_STEPS = 20
"""Number of steps, or of rounds of calls, of which the median time is a part's."""


def step_parts(core: EpisodeCore, steps_per_second: float) -> dict[str, float]:
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
