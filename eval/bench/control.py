"""Cost of a controller tick, part by part, beside the simulator's step.

Everything is timed in one run and given as a ratio to PyBullet's own step, because
machines are noisy. References solve the very states of that run.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from marl_mm.control.compiled.assembly import TASK_ROWS
from marl_mm.control.compiled.parts import repeat_assembly, repeat_levels
from marl_mm.control.config import ControllerConfig
from marl_mm.control.limits import UNBOUNDED
from marl_mm.control.records import (
    VARIABLES,
    Command,
    Priorities,
    Reference,
    ReferenceAt,
)
from marl_mm.control.wbc import WholeBodyController
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.drive import Drive
from marl_mm.envs.task import Task
from marl_mm.envs.tasks.reach import LAYOUT
from marl_mm.progress import Advance, silent
from marl_mm.robot.model import ModelTerms, RobotState
from marl_mm.sim.config import RATE

_SAMPLED = 37
"""Ticks between states that are kept for the references; no divisor of 240."""

_OVERLOAD = np.array([0, 0, 0, 300.0, 0, 0, 0, 0, 0, 0])
"""Torque added to that of the first arm joint [N m]."""

_REPEATS = 20
"""Number of timed calls of the compiled parts on one state."""


class Sample(NamedTuple):
    """Inputs of one call of the controller."""

    state: RobotState
    """State of the robot."""

    terms: ModelTerms
    """Dynamics and kinematics at that state."""

    reference: Reference
    """Targets of the controller."""

    priorities: Priorities
    """Priorities of the controller's tasks."""


def bench_control(
    config: Task, steps: int, seed: int, advance: Advance = silent
) -> dict[str, Any]:
    """Times [us] of a tick and its parts in closed loop, and of other solvers.

    Steps run by turns with and without clocks around the parts: the whole tick is timed
    without them.

    Args:
        config: Task of the episodes.
        steps: Number of environment steps with random actions, with clocks and without.
        seed: Seed of the actions.
        advance: Called with the number of finished steps.
    """
    core = EpisodeCore(config)
    rng = np.random.default_rng(seed)
    core.reset(rng)
    core.step(_action(rng))  # compiles, or loads what was compiled
    clocks = _Clocks(core.drive)
    samples: list[Sample] = []
    stamps: list[float] = []
    ticks, seconds = [], 0.0
    for i in range(steps):
        if i % config.max_steps == 0:
            core.reset(rng)
        stamps[:] = [perf_counter()]
        core.step(_action(rng), lambda tick: stamps.append(perf_counter()))
        seconds += perf_counter() - stamps[0]
        ticks.append(np.diff(stamps))
        with clocks.running(samples):
            core.step(_action(rng))
        advance(1, "")
    core.close()
    phase = {name: np.array(times) for name, times in clocks.times.items()}
    controller = phase["model"] + phase["solve"]
    tick = np.concatenate(ticks)
    simulation = float(np.median(phase["simulation"]))
    solver = core.drive.controller
    return {
        "controller_over_simulation": float(np.median(controller)) / simulation,
        "tick_over_simulation": float(np.median(tick)) / simulation,
        "mean_tick_over_mean_simulation": float(
            tick.mean() / phase["simulation"].mean()
        ),
        "env_steps_per_second": steps / seconds,
        "ticks_per_second": steps * config.ticks_per_step / seconds,
        "real_time_factor": steps * config.ticks_per_step / seconds / RATE,
        "deadline_over_tick_p99": 1 / RATE / float(np.percentile(tick, 99)),
        "deadline_over_controller_p99": 1 / RATE / float(np.percentile(controller, 99)),
        "us": {
            "tick": _spread(tick),
            "simulation": _spread(phase["simulation"]),
            "controller": _spread(controller),
            "model": _spread(phase["model"]),
            "solve": _spread(phase["solve"]),
            "io": _spread(phase["command"] + phase["read"]),
            **_compiled_parts(solver, samples),
        },
        "references_us": {
            name: _spread(times) for name, times in _references(core, samples).items()
        },
        "infeasible_us": {
            name: _spread(times) for name, times in _infeasible(core, samples).items()
        },
        "states_for_references": len(samples),
    }


class _Clocks:
    """Clocks around the parts that a tick calls, which can be taken off again."""

    def __init__(self, drive: Drive) -> None:
        self._parts = {
            "model": (drive.model, "evaluate"),
            "solve": (drive.controller, "along"),
            "command": (drive.world, "command"),
            "simulation": (drive.world, "step"),
            "read": (drive.world, "read"),
        }
        self.times: dict[str, list[float]] = {name: [] for name in self._parts}

    @contextmanager
    def running(self, samples: list[Sample]) -> Iterator[None]:
        """Time every call inside the block; keep some of the controller's inputs."""
        for name, (part, method) in self._parts.items():
            called, times = getattr(part, method), self.times[name]
            timed = (
                _timed_along(called, times, samples)
                if name == "solve"
                else _timed(called, times)
            )
            setattr(part, method, timed)
        try:
            yield
        finally:
            for part, method in self._parts.values():
                delattr(part, method)


def _timed(method: Callable[..., Any], times: list[float]) -> Callable[..., Any]:
    def timed(*arguments: Any) -> Any:
        begin = perf_counter()
        result = method(*arguments)
        times.append(perf_counter() - begin)
        return result

    return timed


def _timed_along(
    along: Callable[..., Any], times: list[float], keep: list[Sample]
) -> Callable[..., Any]:
    """``along`` whose functions are timed, with some of their inputs kept."""

    def timed_along(reference_at: ReferenceAt, priorities: Priorities) -> Any:
        command_at = _timed(along(reference_at, priorities), times)

        def sampled(k: int, state: RobotState, terms: ModelTerms) -> Command:
            command: Command = command_at(k, state, terms)
            if len(times) % _SAMPLED == 0:
                kept_terms = ModelTerms(*(array.copy(order="K") for array in terms))
                keep.append(
                    Sample(state, kept_terms, reference_at(k, state), priorities)
                )
            return command

        return sampled

    return timed_along


def _action(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(LAYOUT.low, LAYOUT.high)


def _spread(times: np.ndarray) -> dict[str, float]:
    """Median, 99th percentile and maximum [us]."""
    return {
        "median": 1e6 * float(np.median(times)),
        "p99": 1e6 * float(np.percentile(times, 99)),
        "max": 1e6 * float(np.max(times)),
    }


def _compiled_parts(
    controller: WholeBodyController, samples: list[Sample]
) -> dict[str, dict[str, float]]:
    """Assembly, levels and QPs of the compiled form, without Python around them."""
    robot, gains, hierarchy, limits = controller.numbers
    assembly, levels, whole = [], [], []
    for state, terms, reference, priorities in samples:
        inputs = tuple(state), tuple(terms), tuple(reference)
        count = controller.rows
        shapes = (TASK_ROWS, VARIABLES), TASK_ROWS, (count, VARIABLES), count, count
        problem = [np.zeros(shape) for shape in shapes]
        assembly.append(
            _per_repeat(repeat_assembly, *inputs, robot, gains, limits, *problem)
        )
        *rows, lower, upper = problem
        wide = np.full_like(lower, -UNBOUNDED), np.full_like(upper, UNBOUNDED)
        rest = priorities.matrices, hierarchy, np.zeros(VARIABLES), np.zeros(4, int)
        levels.append(_per_repeat(repeat_levels, *rows, *wide, *rest))
        whole.append(_per_repeat(repeat_levels, *problem, *rest))
    qp = np.maximum(np.array(whole) - np.array(levels), 0.0)
    return {
        "assembly": _spread(np.array(assembly)),
        "levels": _spread(np.array(levels)),
        "qp": _spread(qp),
    }


def _per_repeat(function: Callable[..., None], *arguments: Any) -> float:
    """Seconds of one repetition."""
    function(*arguments, 1)
    begin = perf_counter()
    function(*arguments, _REPEATS)
    return (perf_counter() - begin) / _REPEATS


def _references(core: EpisodeCore, samples: list[Sample]) -> dict[str, np.ndarray]:
    """Other ways to solve the same states; what is not installed is left out."""
    config = core.task.controller
    times = {
        "compiled": _solve_times(core, replace(config, solver="active-set"), samples),
        "numpy_proxqp": _solve_times(core, replace(config, solver="proxqp"), samples),
    }
    if find_spec("daqp"):
        daqp = replace(config, solver="daqp")
        times["numpy_daqp"] = _solve_times(core, daqp, samples)
    if find_spec("pink") and find_spec("qpsolvers"):
        from marl_mm.eval.bench.pink_reference import PinkReference

        reference = PinkReference(core.drive.model.pinocchio)
        times["pink_weighted_qp"] = _times(
            lambda s: reference.solve(s.state, s.reference), samples
        )
    return times


def _infeasible(core: EpisodeCore, samples: list[Sample]) -> dict[str, np.ndarray]:
    """The same states with a load on joint 1 that no acceleration can carry."""
    loaded = [
        sample._replace(
            terms=sample.terms._replace(nonlinear=sample.terms.nonlinear + _OVERLOAD)
        )
        for sample in samples
    ]
    config = core.task.controller
    return {
        "compiled": _solve_times(core, replace(config, solver="active-set"), loaded),
        "numpy_proxqp": _solve_times(core, replace(config, solver="proxqp"), loaded),
    }


def _solve_times(
    core: EpisodeCore, config: ControllerConfig, samples: list[Sample]
) -> np.ndarray:
    controller = WholeBodyController(core.drive.limits, config, RATE)
    return _times(lambda sample: controller.solve(*sample), samples)


def _times(solve: Callable[[Sample], Any], samples: list[Sample]) -> np.ndarray:
    solve(samples[0])
    times = []
    for sample in samples:
        begin = perf_counter()
        solve(sample)
        times.append(perf_counter() - begin)
    return np.array(times)
