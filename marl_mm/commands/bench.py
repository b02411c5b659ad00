"""marl-mm bench: what a controller tick costs, against the simulator's step."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from marl_mm.commands.options import check_positive, check_seed
from marl_mm.commands.parser import parse_subcommand
from marl_mm.control.config import Form, Solver
from marl_mm.envs.config import reach_config
from marl_mm.envs.core import ReachCore
from marl_mm.layout import ACTION_HIGH, ACTION_LOW


@dataclass(frozen=True)
class BenchControl:
    """Time the phases of a controller tick in closed loop, PyBullet's step included."""

    steps: int = 40
    """Environment steps of 240 ticks, each with a random action."""

    seed: int = 0
    """Of the actions."""

    form: Form = "blend"
    """How alpha enters the controller."""

    solver: Solver = "active-set"
    """Compiled controller, or the readable reference."""

    json: bool = False
    """Print JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm bench``."""
    options = parse_subcommand(
        {"control": BenchControl},
        "marl-mm bench",
        "Measure the controller against the simulator.",
        arguments,
    )
    check_positive(steps=options.steps)
    check_seed(options.seed)
    result = bench_control(options)
    if options.json:
        print(json.dumps(result, indent=2))
        return
    table = Table("quantity", "value")
    for key, value in result.items():
        if isinstance(value, float):
            table.add_row(key, f"{value:.3g}")
    Console().print(table)


def bench_control(options: BenchControl) -> dict[str, Any]:
    """Median time of each phase of a tick [us], and their ratios.

    The environment runs as it always does, with a clock around each part it calls, so
    that a noisy machine disturbs all parts alike. The controller is model and
    hierarchy; the tick is everything, clocks included.
    """
    overrides = {"controller": {"form": options.form, "solver": options.solver}}
    core = ReachCore(reach_config("Reach-v0", overrides))
    rng = np.random.default_rng(options.seed)
    _run_steps(core, rng, 1)  # compiles, or loads what was compiled
    seconds = _run_steps(core, rng, options.steps).sum()
    clocks = {
        "model": _clocked(core.drive.model, "evaluate"),
        "hierarchy": _clocked(core.drive.controller, "solve"),
        "command": _clocked(core.drive.world, "command"),
        "simulation": _clocked(core.drive.world, "step"),
        "read": _clocked(core.drive.world, "read"),
    }
    steps = _run_steps(core, rng, options.steps, clocks.values())
    core.close()
    ticks = core.config.ticks_per_step
    phase = {name: 1e6 * np.array(times) for name, times in clocks.items()}
    controller = phase["model"] + phase["hierarchy"]
    io = phase["command"] + phase["read"]
    simulation = float(np.median(phase["simulation"]))
    tick = float(1e6 * np.median(steps) / ticks)
    return {
        "controller_over_simulation": float(np.median(controller)) / simulation,
        "tick_over_simulation": tick / simulation,
        "env_steps_per_second": options.steps / float(seconds),
        "ticks_per_second": ticks * options.steps / float(seconds),
        "simulation_us": simulation,
        "io_us": float(np.median(io)),
        "model_us": float(np.median(phase["model"])),
        "hierarchy_us": float(np.median(phase["hierarchy"])),
        "controller_us": float(np.median(controller)),
        "controller_us_99th_percentile": float(np.percentile(controller, 99)),
        "tick_us": tick,
        "options": asdict(options),
    }


def _run_steps(
    core: ReachCore,
    rng: np.random.Generator,
    count: int,
    clocks: Iterable[list[float]] = (),
) -> np.ndarray:
    """Environment steps with random actions; the time each took, shape (count,) [s].

    What the clocks counted during resets is taken out.
    """
    times = np.empty(count)
    for i in range(count):
        if i % core.config.max_steps == 0:
            marks = [len(clock) for clock in clocks]
            core.reset(rng)
            for clock, mark in zip(clocks, marks, strict=True):
                del clock[mark:]
        action = rng.uniform(ACTION_LOW, ACTION_HIGH)
        begin = perf_counter()
        core.step(action)
        times[i] = perf_counter() - begin
    return times


def _clocked(part: object, name: str) -> list[float]:
    """Time every call of a method from now on; the times [s], growing."""
    method = getattr(part, name)
    times: list[float] = []

    def timed(*arguments: Any) -> Any:
        begin = perf_counter()
        result = method(*arguments)
        times.append(perf_counter() - begin)
        return result

    setattr(part, name, timed)
    return times
