"""Offline learning: updates per second beside the authors' TD3+BC; several seeds.

All learn from the dataset that ships, with batches of 256 and two layers of 256, and
take turns, so that a noisy machine is as noisy for each.
"""

import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from tempfile import TemporaryDirectory, TemporaryFile
from time import perf_counter
from typing import Any

import numpy as np
import psutil

from marl_mm.algorithms.mabc import Mabc
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.matd3_bc import Matd3Bc
from marl_mm.algorithms.matd3_bc_config import Matd3BcConfig
from marl_mm.algorithms.registry import preset
from marl_mm.algorithms.speed import matrix_products, prepare_for_small_networks
from marl_mm.algorithms.td3_bc import Td3Bc
from marl_mm.algorithms.td3_bc_config import Td3BcConfig
from marl_mm.datasets.location import SHIPPED
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.envs.registry import make_task
from marl_mm.errors import MarlMmError
from marl_mm.eval.bench.td3_bc_reference import PlainTd3Bc
from marl_mm.progress import Advance, silent
from marl_mm.workers import available_cores

AUTHORS = "td3-bc, its authors' restated"
AUTHORS_AUTO = f"{AUTHORS}, --precision auto"
PLAIN = "td3-bc, no more than theirs"
PLAIN_HIGHEST = f"{PLAIN}, --precision highest"
HIGHEST = "td3-bc, --precision highest"

HIDDEN = (256, 256)

LEARNERS = 8
"""Number of timed learners."""

_TURN = 100
"""Updates until it is another's turn."""

_LOOK_EVERY = 0.5
"""Time between measurements of a command's memory [s]."""

MANY = 32
"""Seeds that learn side by side on a GPU."""


def bench_offline(
    updates: int, seed: int = 0, advance: Advance = silent
) -> dict[str, Any]:
    """Updates per second of each learner, and ours over the authors'.

    Args:
        updates: Number of updates of each algorithm, in turns.
        seed: Seed of networks and batches.
        advance: Called with the number of finished updates.
    """
    prepare_for_small_networks()
    learners = _learners(seed)
    rates: dict[str, list[float]] = {name: [] for name in learners}
    for turn in range(-1, max(1, updates // _TURN)):
        for name, update in learners.items():
            rate = _rate(update, _TURN)
            if turn >= 0:  # the first one warms caches
                rates[name].append(rate)
                advance(_TURN, name)
    authors = np.array(rates[AUTHORS])
    return {
        "updates_per_second": {name: float(np.median(r)) for name, r in rates.items()},
        "over_authors": {
            name: float(np.median(np.array(rates[name]) / authors))
            for name in rates
            if name != AUTHORS
        },
    }


def bench_seeds(
    updates: int, seeds: int, turns: int = 2, advance: Advance = silent
) -> dict[str, float]:
    """The command ``marl-mm train td3-bc`` with several seeds, over one, in turns.

    Args:
        updates: Number of updates of each seed; the start of a command counts too.
        seeds: Number of seeds.
        turns: Number of turns of each command; the shortest counts.
        advance: Called with the number of trained seeds.

    Returns:
        Seconds of each command, the throughput of several seeds over that of one, and
        the most memory of all processes [MiB], where shared memory counts once.
    """
    walls: dict[int, list[float]] = {1: [], seeds: []}
    memory = dict.fromkeys(walls, 0.0)
    for _ in range(turns):
        for count, seconds in walls.items():
            with TemporaryDirectory() as folder:
                wall, most = _train(updates, count, folder)
            seconds.append(wall)
            memory[count] = max(memory[count], most)
            advance(count, f"{count} seeds")
    single, several = min(walls[1]), min(walls[seeds])
    return {
        "seeds": seeds,
        "cores": available_cores(),
        "one_s": single,
        "several_s": several,
        "throughput_over_one": seeds * single / several,
        "one_memory_mib": memory[1],
        "several_memory_mib": memory[seeds],
    }


def bench_side_by_side(
    updates: int, seeds: int = MANY, device: str = "cuda", advance: Advance = silent
) -> dict[str, float]:
    """Updates per second of many seeds of TD3+BC in one process, together, over one.

    Args:
        updates: Number of updates of each seed.
        seeds: Number of seeds.
        device: Name of a GPU; on a CPU seeds are trained in processes instead.
        advance: Called with the number of finished updates.
    """
    arrays, rewards = shipped_arrays(), make_task()
    config = Td3BcConfig(hidden=HIDDEN)
    rates = {}
    for count in (1, seeds):
        algorithm = Td3Bc(config, arrays, rewards, range(count), device)
        with matrix_products("auto"):
            _rate(algorithm.update, min(updates, _TURN))  # warms caches
            algorithm.diagnose()["q/data"].cpu()  # waits for what is under way
            begin = perf_counter()
            for _ in range(updates):
                algorithm.update()
            algorithm.diagnose()["q/data"].cpu()
        rates[count] = count * updates / (perf_counter() - begin)
        advance(updates, f"{count} seeds")
    return {
        "seeds": seeds,
        "one_updates_per_second": rates[1],
        "all_updates_per_second": rates[seeds],
        "over_one": rates[seeds] / rates[1],
    }


def _train(updates: int, seeds: int, folder: str) -> tuple[float, float]:
    """Seconds that the command took, and the most memory of its processes [MiB]."""
    words = (
        f"-m marl_mm train td3-bc --dataset {SHIPPED} --updates {updates} --hidden "
        f"{' '.join(map(str, HIDDEN))} --curve-every {updates} --curve-episodes 1 "
        f"--eval-episodes 2 --out {folder} --overwrite --seeds"
    ).split()
    command = [sys.executable, *words, *map(str, range(seeds))]
    begin, most = perf_counter(), 0.0
    quiet = subprocess.DEVNULL
    with (
        TemporaryFile("w+") as errors,
        subprocess.Popen(command, stdout=quiet, stderr=errors) as job,
    ):
        while job.poll() is None:
            most = max(most, _memory(psutil.Process(job.pid)))
            with suppress(subprocess.TimeoutExpired):
                job.wait(_LOOK_EVERY)
        wall = perf_counter() - begin
        if job.returncode:
            errors.seek(0)
            complaint = errors.read().strip()[-200:]
            raise MarlMmError(f"{' '.join(command)} failed: {complaint}")
    return wall, most


def _memory(process: psutil.Process) -> float:
    """Proportional set size of a process and its children [MiB]."""
    total = 0
    with suppress(psutil.NoSuchProcess):  # it may end meanwhile
        for member in (process, *process.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                total += member.memory_full_info().pss
    return total / 2**20


def _learners(seed: int) -> dict[str, Callable[[], object]]:
    arrays, rewards = shipped_arrays(), make_task()
    tuned, plain = Td3BcConfig(hidden=HIDDEN), plain_config()
    others = Matd3BcConfig(hidden=HIDDEN)
    cloning = MabcConfig(hidden=HIDDEN)
    auto = matrix_products("auto")  # as a decorator
    return {
        AUTHORS: PlainTd3Bc(arrays, plain, seed).update,
        AUTHORS_AUTO: auto(PlainTd3Bc(arrays, plain, seed).update),
        PLAIN: auto(Td3Bc(plain, arrays, rewards, [seed]).update),
        PLAIN_HIGHEST: Td3Bc(plain, arrays, rewards, [seed]).update,
        "td3-bc": auto(Td3Bc(tuned, arrays, rewards, [seed]).update),
        HIGHEST: Td3Bc(tuned, arrays, rewards, [seed]).update,
        "matd3-bc": auto(Matd3Bc(others, arrays, rewards, [seed]).update),
        "mabc": auto(Mabc(cloning, arrays, rewards, [seed]).update),
    }


def plain_config() -> Td3BcConfig:
    """Our settings that match the authors' code."""
    config = preset("td3-bc", "paper")
    assert isinstance(config, Td3BcConfig)
    return replace(config, hidden=HIDDEN)


def _rate(update: Callable[[], object], updates: int) -> float:
    begin = perf_counter()
    for _ in range(updates):
        update()
    return updates / (perf_counter() - begin)
