"""Work that is killed at a random moment, and goes on: the same bytes as without.

    python tests/cli/kills.py FOLDER POINTS [SEED]

Reads kinds of work, a line each. Of each it prints a line of JSON for each point whose
files differ, and a last one with the counts. Each attempt is a fork of this process,
which has imported everything: no attempt is killed while it merely starts.
"""

import gc
import hashlib
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

import marl_mm
import marl_mm.runs.train  # noqa: F401
from marl_mm.datasets import cache
from marl_mm.datasets.convert import read_apart  # noqa: F401
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.location import locate
from marl_mm.datasets.selection import Part, mix, write_selection
from marl_mm.eval import figures
from marl_mm.eval.studies import Setting, Source, Study
from marl_mm.eval.studies.runner import StudyRunner  # noqa: F401
from marl_mm.files import write_json

torch.set_num_threads(1)
figures.learning_curve = figures.online_curve = lambda metrics, path: path.touch()

SMALL: dict[str, Any] = {
    "hidden": (16, 16),
    "eval_episodes": 2,
    "curve_episodes": 2,
    "max_steps": 5,
}
ENGINE: Any = "mujoco"  # the faster one
DATA, OTHER = "../data", "../other"


def collect() -> None:
    location = locate("./new")
    begun = location.folder.exists() or location.working.exists()
    marl_mm.collect(
        "pd", steps=40, seed=5, dataset="./new", resume=begun, engine=ENGINE
    )


def offline() -> None:
    begun = Path("run/0/config.json").exists()
    updates: dict[str, Any] = {"updates": 400, "curve_every": 200}
    marl_mm.train("mabc", DATA, out="run", resume=begun, **updates, **SMALL)


def fine_tuned() -> None:
    begun = Path("run/0/config.json").exists()
    learn: dict[str, Any] = {"updates": 100, "online_steps": 40, "online_every": 10}
    marl_mm.train("td3-bc", DATA, out="run", resume=begun, **learn, **SMALL)


def online() -> None:
    begun = Path("run/0/config.json").exists()
    learn: dict[str, Any] = {"episodes": 24, "warm_up": 20, "updates_per_episode": 10}
    marl_mm.train(
        "maddpg-her", out="run", resume=begun, engine=ENGINE, **learn, **SMALL
    )


def study() -> None:
    source = Source("pd", "Reach-v0", 40, name="pd", engine=ENGINE)
    settings = [Setting(name, name, name) for name in ("mabc", "td3-bc")]
    cells = [(source, setting) for setting in settings]
    Study("Two algorithms.", cells, seeds=1).run(
        "results", runs="runs", budget="smoke", resume=True
    )


def mixed() -> None:
    parts = [Part(load_dataset(name), 30) for name in (DATA, OTHER)]
    write_selection(locate("./mix"), mix(parts, 0), overwrite=True)


def cached() -> None:
    os.environ[cache.FOLDER_VARIABLE] = str(Path("cache").absolute())
    write_json(Path("hash.json"), load_dataset(DATA).fingerprint)


KINDS: dict[str, Callable[[], None]] = {
    "collect": collect,
    "offline": offline,
    "fine-tuned": fine_tuned,
    "online": online,
    "study": study,
    "mix": mixed,
    "cache": cached,
}

UNLIKE = ("events.out.tfevents", "learning_curve.png")
"""Beginnings of names of files that hold the time, or that nothing reads back."""


def attempt(kind: str, folder: Path, seconds: float | None = None) -> tuple[int, float]:
    """Do the work in a folder; exit status and time [s]. It is killed after a time."""
    folder.mkdir(exist_ok=True)
    begin = time.monotonic()
    child = os.fork()
    if not child:
        try:
            os.chdir(folder)
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            KINDS[kind]()
            os._exit(0)
        except BaseException as error:
            os.write(2, f"{type(error).__name__}: {error}\n".encode())
            os._exit(1)
    if seconds is not None:
        time.sleep(seconds)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return status, time.monotonic() - begin


def contents(folder: Path) -> dict[str, str]:
    """Hashes of all files, by name; what a killed process left is there, too."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.startswith(UNLIKE)
    }


def tell(values: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


def run(kind: str, points: int, folder: Path, seed: int) -> dict[str, int]:
    """Kill the work at some random points, and count what became of it."""
    os.environ["MINARI_DATASETS_PATH"] = str(folder / "datasets")
    os.environ[cache.FOLDER_VARIABLE] = str(folder / "own-cache")
    if not (folder / "data").exists():
        for name, own in (("data", 1), ("other", 2)):
            status = os.fork()
            if not status:
                dataset = str(folder / name)
                marl_mm.collect(
                    "pd", steps=60, seed=own, dataset=dataset, engine=ENGINE
                )
                os._exit(0)
            assert os.waitpid(status, 0)[1] == 0
        quick: dict[str, Any] = {"max_steps": 1, "workers": 1, "engine": ENGINE}
        marl_mm.evaluate("random", episodes=2, **quick)  # loads compiled code
        gc.freeze()
    place = folder / "work"  # always the same: records hold absolute paths
    status, seconds = attempt(kind, place)
    assert status == 0, "the work fails where nobody disturbs it"
    whole = contents(place)
    shutil.rmtree(place)
    rng = np.random.default_rng([seed, *kind.encode()])
    counts = {"killed": 0, "ended before": 0, "same": 0, "other": 0, "failed": 0}
    for number in range(points):
        status, _ = attempt(kind, place, float(rng.uniform(0, seconds)))
        counts["killed" if status else "ended before"] += 1
        status, _ = attempt(kind, place)
        now = contents(place)
        outcome = "failed" if status else "same" if now == whole else "other"
        counts[outcome] += 1
        if outcome != "same":
            differ = sorted(
                name for name in {*whole, *now} if whole.get(name) != now.get(name)
            )
            tell({"point": number, outcome: differ})
            place.rename(folder / f"point-{number}")
        else:
            shutil.rmtree(place)
    return counts


if __name__ == "__main__":
    folder, points = Path(sys.argv[1]).absolute(), int(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    seed = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    for kind in map(str.strip, sys.stdin):
        tell({"kind": kind, **run(kind, points, folder, seed)})
