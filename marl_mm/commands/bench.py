"""marl-mm bench: what ticks, updates and data cost, and what abuse does."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from marl_mm.commands.options import task_help
from marl_mm.commands.output import print_rows, show
from marl_mm.commands.parser import parse_subcommand
from marl_mm.control.config import Form, Solver
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.progress import Bar, progress_bars
from marl_mm.runs.settings import check_positive, check_seed
from marl_mm.sim.config import ENGINES, Engine, is_installed
from marl_mm.versions import machine, versions
from marl_mm.workers import available_cores


def _installed() -> tuple[Engine, ...]:
    return tuple(filter(is_installed, ENGINES))


@dataclass(frozen=True)
class _Bench:
    seed: int = 0
    """Seed of actions, episodes and networks."""

    json: bool = False
    """Whether to print JSON."""


@dataclass(frozen=True)
class BenchControl(_Bench):
    """Time the parts of a controller tick in closed loop, PyBullet's step included.

    On the same states: numpy with ProxQP and DAQP, and Pink's weighted QP if installed.
    """

    steps: int = 40
    """Environment steps of 240 ticks with random actions, with clocks and without."""

    form: Form = "blend"
    """Form in which alpha enters the controller."""

    solver: Solver = "active-set"
    """Compiled controller, or the readable reference."""

    def measure(self, bar: Bar) -> dict[str, Any]:
        """The benchmark of these options."""
        from marl_mm.eval.bench.control import bench_control
        from marl_mm.sim.world import check_engine

        choice = {"form": self.form, "solver": self.solver}
        on_bullet = {"simulation": {"engine": "bullet"}}
        task = make_task("Reach-v0", {"controller": choice, **on_bullet})
        check_engine("bullet", advice="")
        advance = bar("bench control", self.steps)
        return bench_control(task, self.steps, self.seed, advance)


@dataclass(frozen=True)
class BenchAbuse(_Bench):
    """Drive the robot into its limits at random, and report the excess over each."""

    ticks: int = 240_000
    """Controller ticks of 1/240 s; rounded up to whole steps of 240."""

    form: Form = "blend"
    """Form in which alpha enters the controller."""

    def measure(self, bar: Bar) -> dict[str, Any]:
        """The benchmark of these options."""
        from marl_mm.eval.bench.abuse import abuse

        task = make_task("Reach-v0", {"controller": {"form": self.form}})
        return abuse(task, self.ticks, self.seed, bar("bench abuse", self.ticks))


@dataclass(frozen=True)
class BenchTrain(_Bench):
    """Count gradient updates per second of all learners, and time how teams act.

    Online ones in turns with Stable-Baselines3's DDPG+HER (extra "bench") at the same
    batch, hidden layers (it has no layer norm) and hindsight. Offline ones on one and
    two threads, at batches of 256 and two layers of 256, in turns with TD3+BC as its
    authors wrote it, and with d3rlpy's in an environment of its own.
    """

    updates: int = 500
    """Gradient updates of each algorithm, rounded up to hundreds; 500 take 15 min."""

    env_steps: int = 3_000
    """Environment steps of a comparison of success; 3,000 take 3 min, 0 skips it."""

    seeds: int = 5
    """Seeds of "marl-mm train" of ten times the updates, timed beside one; 1 skips."""

    d3rlpy: Path | None = None
    """Python of an environment with d3rlpy 2.8.1; default without it."""

    gpu: bool = False
    """Only 1, 5 and 16 seeds side by side on a GPU, and one on a core; 100: 3 min."""

    def measure(self, bar: Bar) -> dict[str, Any]:
        """The benchmark of these options."""
        from marl_mm.eval.bench import side_by_side, train

        if self.gpu:
            return side_by_side.bench_gpu(self.updates, bar)
        settings = self.updates, self.env_steps, self.seeds, self.seed, self.d3rlpy
        return train.bench_train(*settings, bar)


@dataclass(frozen=True)
class BenchData(_Bench):
    """Count collected steps per second, and time loading; sizes on disk.

    Beside the bare environment, and Minari's own reader and writer.
    """

    episodes: int = 8
    """Episodes per turn and number of workers."""

    workers: tuple[int, ...] = (1, 2)
    """Numbers of processes to compare."""

    load_steps: int = 60_000
    """Steps of the dataset whose loading is timed."""

    def measure(self, bar: Bar) -> dict[str, Any]:
        """The benchmark of these options."""
        from marl_mm.eval.bench.data import bench_data

        check_positive(workers=min(self.workers, default=0))
        return bench_data(self.episodes, self.workers, self.load_steps, self.seed, bar)


@dataclass(frozen=True)
class BenchEnv(_Bench):
    """Count environment steps per second of the engines, in turns in one process.

    Beside them the loop in Python that a watch of every tick asks for, the parts of a
    compiled tick, and a vector of environments against one.
    """

    task: Annotated[str, task_help("{}.")] = DEFAULT

    engine: tuple[Engine, ...] = field(default_factory=_installed)
    """Engines to compare; bullet is their reference."""

    turns: int = 8
    """Turns of each engine and kind of alpha."""

    steps: int = 10
    """Environment steps of a turn with random actions."""

    vector: int = 32
    """Environments of a vector that takes turns with a single one."""

    workers: int = 2
    """Threads or processes of the vector."""

    def measure(self, bar: Bar) -> dict[str, Any]:
        """The benchmark of these options."""
        from marl_mm.eval.bench.env import bench_env

        check_positive(vector=self.vector, workers=self.workers)
        settings = self.turns, self.steps, self.seed, self.vector, self.workers
        return bench_env(self.task, self.engine, *settings, bar)


@dataclass(frozen=True)
class BenchLearning(_Bench):
    """Time until online learners reach 95 % of goals, on engines in turns.

    It trains as ``marl-mm train`` does with the tuned presets.
    """

    task: Annotated[str, task_help("{}.")] = DEFAULT

    algorithm: tuple[str, ...] = ("ddpg-her", "maddpg-her")
    """Online algorithms."""

    engine: tuple[Engine, ...] = field(default_factory=_installed)
    """Engines to compare; the first is the others' reference."""

    seeds: int = 3
    """Number of seeds, from ``seed`` on."""

    workers: int = 2
    """Processes, or threads, that run episodes."""

    def measure(self, bar: Bar) -> dict[str, Any]:
        """The benchmark of these options."""
        from marl_mm.eval.bench.learning import bench_learning

        check_positive(seeds=self.seeds, workers=self.workers)
        seeds, choice = range(self.seed, self.seed + self.seeds), self.engine
        settings = self.task, self.algorithm, choice, seeds, self.workers
        return bench_learning(*settings, bar)


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm bench``."""
    _, options = parse_subcommand(
        dict(
            env=BenchEnv,
            control=BenchControl,
            abuse=BenchAbuse,
            train=BenchTrain,
            learning=BenchLearning,
            data=BenchData,
        ),
        "marl-mm bench",
        "Measure the speed of steps, training and data, and the controller's limits.",
        arguments,
    )
    check_seed(options.seed)
    begun = machine() | {"cores": available_cores(), "load": os.getloadavg()[0]}
    values = {k: v for k, v in asdict(options).items() if k != "json"}
    counts = [k for k, v in values.items() if type(v) is int]  # no bool
    check_positive(**{k: values[k] for k in counts if k not in ("seed", "env_steps")})
    with progress_bars() as bar:
        result = options.measure(bar) | {"options": values}
    result["options"].pop("d3rlpy", None)  # a path of this machine
    if options.json:
        show(result | {"versions": versions(), "machine": begun})
    else:
        print_rows([*_rows(result)], options.json)


def _rows(values: Mapping[str, Any], prefix: str = "") -> Iterator[dict[str, str]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _rows(value, f"{prefix}{key} ")
        else:
            text = f"{value:.4g}" if isinstance(value, float) else str(value)
            yield {"quantity": f"{prefix}{key}", "value": text}
