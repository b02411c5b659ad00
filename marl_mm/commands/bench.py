"""marl-mm bench: what a controller tick costs, against the simulator's step."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from marl_mm.commands.options import check_positive, check_seed
from marl_mm.control.config import Form, Solver
from marl_mm.control.tasks.task import Reference
from marl_mm.envs.config import reach_config
from marl_mm.envs.core import ReachCore
from marl_mm.sim.bullet import RATE

_PHASES = ("model", "hierarchy", "io", "simulation")


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
    options = tyro.extras.subcommand_cli_from_dict(
        {"control": BenchControl},
        prog="marl-mm bench",
        description="Measure the controller against the simulator.",
        args=arguments,
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

    The controller is model and hierarchy; the tick is everything. All phases are timed
    in the same ticks, so that a noisy machine disturbs them alike.
    """
    overrides = {"controller": {"form": options.form, "solver": options.solver}}
    core = ReachCore(reach_config("Reach-v0", overrides))
    rng = np.random.default_rng(options.seed)
    core.reset(rng)
    core.step(np.array([0.0, 0.0, 0.0, 0.5]))  # compiles or loads the compiled code
    ticks = core.config.ticks_per_step
    times = np.empty((options.steps * ticks, len(_PHASES)))
    for step in range(options.steps):
        if step % core.config.max_steps == 0:
            core.reset(rng)
        _time_step(core, rng, times[step * ticks : (step + 1) * ticks])
    begin = perf_counter()
    core.reset(rng)
    for _ in range(options.steps):
        core.step(rng.uniform([-1, -1, -1, 0], 1))
    seconds = perf_counter() - begin
    core.close()
    median = dict(zip(_PHASES, 1e6 * np.median(times, axis=0), strict=True))
    controller = np.median(times[:, :2].sum(axis=1))
    tick = np.median(times.sum(axis=1))
    simulation = np.median(times[:, 3])
    return {
        "controller_over_simulation": float(controller / simulation),
        "tick_over_simulation": float(tick / simulation),
        "env_steps_per_second": options.steps / seconds,
        "ticks_per_second": float(1 / tick),
        **{f"{name}_us": float(value) for name, value in median.items()},
        "controller_us": float(1e6 * controller),
        "tick_us": float(1e6 * tick),
        "tick_us_99th_percentile": float(1e6 * np.percentile(times.sum(axis=1), 99)),
        "options": asdict(options),
    }


def _time_step(core: ReachCore, rng: np.random.Generator, times: np.ndarray) -> None:
    """One environment step with a random action, phase by phase."""
    world, model, controller = core.world, core.model, core.controller
    state = world.read()
    start = model.evaluate(state)
    rotation_w = np.ascontiguousarray(start.rotation_w).copy()
    target_w = world.grasp_position_w() + rng.uniform(-0.1, 0.1, 3)
    posture, alpha = state.q[4:].copy(), float(rng.uniform())
    speed = yaw_rate = 0.0
    for row in times:
        reference = Reference(target_w, rotation_w, state.q[:2], 0.0, 0.0, posture)
        t0 = perf_counter()
        terms = model.evaluate(state)
        t1 = perf_counter()
        command = controller.tick(state, terms, reference, alpha)
        t2 = perf_counter()
        speed += command.acceleration[0] / RATE
        yaw_rate += command.acceleration[1] / RATE
        world.command(speed, yaw_rate, command.torque)
        t3 = perf_counter()
        world.step()
        t4 = perf_counter()
        state = world.read()
        t5 = perf_counter()
        row[:] = t1 - t0, t2 - t1, (t3 - t2) + (t5 - t4), t4 - t3
