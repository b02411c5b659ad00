"""marl-mm bench: what ticks, updates and data cost, and what abuse does."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from marl_mm.commands.parser import parse_subcommand
from marl_mm.control.config import Form, Solver
from marl_mm.envs.registry import make_task
from marl_mm.errors import UsageError
from marl_mm.eval.abuse import abuse
from marl_mm.eval.bench import bench_control
from marl_mm.progress import progress_bar
from marl_mm.runs.settings import check_positive, check_seed
from marl_mm.versions import versions


@dataclass(frozen=True)
class BenchControl:
    """Time the parts of a controller tick in closed loop, PyBullet's step included.

    Beside them, on the same states: the readable numpy form with ProxQP and with DAQP,
    and Pink with the same tasks as one weighted QP (optional extra "bench").
    """

    steps: int = 40
    """Environment steps of 240 ticks with random actions, with clocks and without."""

    seed: int = 0
    """Of the actions."""

    form: Form = "blend"
    """How alpha enters the controller."""

    solver: Solver = "active-set"
    """Compiled controller, or the readable reference."""

    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class BenchAbuse:
    """Drive the robot into its limits at random, and tell how far each was passed."""

    ticks: int = 240_000
    """Controller ticks of 1/240 s; rounded up to whole steps of 240."""

    seed: int = 0
    """Of targets and alphas."""

    form: Form = "blend"
    """How alpha enters the controller."""

    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class BenchTrain:
    """Count gradient updates per second on one thread, of online and offline learners.

    Beside DDPG+HER and MADDPG+HER, in turns: Stable-Baselines3's DDPG+HER (optional
    extra "bench") with the same batch, hidden layers (it has no layer norm) and
    hindsight. Beside TD3+BC, MATD3+BC and MABC, with batches of 256 and two layers of
    256: TD3+BC as its authors wrote it; and several seeds at once beside one.
    """

    updates: int = 2_000
    """Of each algorithm, rounded down to hundreds."""

    env_steps: int = 3_000
    """Also train ours and theirs from nothing for so many steps of the environment, and
    compare their success; 3,000 take about three minutes, 0 leaves it out."""

    seeds: int = 3
    """Also run "marl-mm train td3-bc" with so many seeds and with one, twice, and
    compare the throughput; with 2,000 updates that takes about three minutes, 1 leaves
    it out."""

    seed: int = 0
    """Of networks and episodes."""

    json: bool = False
    """Print JSON."""


@dataclass(frozen=True)
class BenchData:
    """Count collected steps per second, and time loading; sizes on disk.

    Beside them: the bare environment, blocks welded to the hand in place of held by
    friction, and Minari's own reader and writer.
    """

    episodes: int = 8
    """Of 25 random steps, per turn and number of workers; and of the script's, per kind
    of grasp."""

    workers: tuple[int, ...] = (1, 2)
    """Numbers of processes to compare."""

    load_steps: int = 60_000
    """Size of the dataset whose loading is timed."""

    seed: int = 0
    """Of the episodes."""

    json: bool = False
    """Print JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm bench``."""
    _, options = parse_subcommand(
        {
            "control": BenchControl,
            "abuse": BenchAbuse,
            "train": BenchTrain,
            "data": BenchData,
        },
        "marl-mm bench",
        "Measure the controller's time and limits, and the speed of training and data.",
        arguments,
    )
    check_seed(options.seed)
    if isinstance(options, BenchControl):
        result = _control(options)
    elif isinstance(options, BenchAbuse):
        result = _abuse(options)
    elif isinstance(options, BenchTrain):
        result = _train(options)
    else:
        result = _data(options)
    result["options"] = {k: v for k, v in asdict(options).items() if k != "json"}
    result["versions"] = versions()
    if options.json:
        print(json.dumps(result, indent=2))
        return
    table = Table("quantity", "value")
    _add_rows(table, {k: v for k, v in result.items() if k != "versions"}, "")
    Console().print(table)


def _control(options: BenchControl) -> dict[str, Any]:
    check_positive(steps=options.steps)
    overrides = {"controller": {"form": options.form, "solver": options.solver}}
    with progress_bar("bench control", options.steps) as advance:
        config = make_task("Reach-v0", overrides)
        return bench_control(config, options.steps, options.seed, advance)


def _abuse(options: BenchAbuse) -> dict[str, Any]:
    check_positive(ticks=options.ticks)
    config = make_task("Reach-v0", {"controller": {"form": options.form}})
    with progress_bar("bench abuse", options.ticks) as advance:
        return abuse(config, options.ticks, options.seed, advance)


def _train(options: BenchTrain) -> dict[str, Any]:
    import torch

    from marl_mm.eval.bench_offline import (
        LEARNERS,
        bench_offline,
        bench_seeds,
        bench_side_by_side,
    )
    from marl_mm.eval.bench_train import (  # torch takes a second to import
        bench_success,
        bench_train,
    )

    check_positive(seeds=options.seeds)
    if options.updates < 100:
        raise UsageError(f"--updates is {options.updates}, expected >= 100")
    if options.env_steps < 0:
        raise UsageError(f"--env-steps is {options.env_steps}, expected >= 0")
    sb3 = find_spec("stable_baselines3") is not None
    learners = 4 if sb3 else 3
    turns = max(options.updates - options.updates % 100, 100)
    with progress_bar("bench train", learners * turns) as advance:
        result = bench_train(options.updates, options.seed, sb3, advance=advance)
    if options.env_steps:
        total = options.env_steps * (2 if sb3 else 1)
        with progress_bar("bench success", total) as advance:
            result["success"] = bench_success(
                options.env_steps, options.seed, sb3=sb3, advance=advance
            )
    with progress_bar("bench offline", turns * LEARNERS) as advance:
        result["offline"] = bench_offline(turns, options.seed, advance)
    if options.seeds > 1:
        with progress_bar("bench seeds", 2 * (1 + options.seeds)) as advance:
            result["seeds"] = bench_seeds(turns, options.seeds, advance=advance)
    if torch.cuda.is_available():
        with progress_bar("bench GPU", 2 * turns) as advance:
            result["side_by_side"] = bench_side_by_side(turns, advance=advance)
    return result


def _data(options: BenchData) -> dict[str, Any]:
    from marl_mm.eval.bench_data import bench_collection, bench_grasps, bench_storage

    check_positive(episodes=options.episodes, load_steps=options.load_steps)
    if not options.workers:
        raise UsageError("--workers names no number of processes")
    check_positive(workers=min(options.workers))
    with TemporaryDirectory() as name:
        folder = Path(name)
        total = 4 * options.episodes * (1 + len(options.workers))
        with progress_bar("bench collection", total) as advance:
            result, episodes = bench_collection(
                options.episodes,
                options.workers,
                options.seed,
                folder / "journal",
                advance,
            )
        with progress_bar("bench grasps", 6 * options.episodes + 2) as advance:
            result["grasps"] = bench_grasps(options.episodes, options.seed, advance)
        with progress_bar("bench storage", 4) as advance:
            result["storage"] = bench_storage(
                episodes, options.load_steps, folder, advance
            )
    return result


def _add_rows(table: Table, values: Mapping[str, Any], prefix: str) -> None:
    for key, value in values.items():
        if isinstance(value, Mapping):
            _add_rows(table, value, f"{prefix}{key} ")
        else:
            text = f"{value:.4g}" if isinstance(value, float) else str(value)
            table.add_row(f"{prefix}{key}", escape(text))
