"""What is kept of offline runs: their evaluations and learning curves, as rows.

Tables and figures are made of these alone. Three files for each cell::

    ROWS/DATASET/SETTING.csv.gz         a line per seed, probe and goal
    ROWS/DATASET/SETTING.curve.csv.gz   a line per seed and point of the learning curve
    ROWS/DATASET/SETTING.json           what the runs were made of
"""

import json
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from marl_mm.algorithms.runlog import read_metrics
from marl_mm.config_diff import as_json, refuse_other_config
from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.ablation import LAST, Cell, Probe
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import as_read, read_rows, write_csv
from marl_mm.files import only_here, write_json

_MEASURED = ("steps", "return", "final_distance", "d_mm", "d_mp", "alpha")
CRITIC = ("q/policy", "q/slope")
"""What the critics say; see ``Td3Bc.diagnose``."""

_CURVE = ("success/all", "success/forward", "success/backward", "return/all", *CRITIC)


def probe_file(run: Path, probe: Probe) -> Path:
    """Where a run keeps an evaluation."""
    return run / ("eval.json" if probe == LAST else f"eval_{probe.name}.json")


def probe_way(probe: Probe) -> dict[str, Any]:
    """What is done, whatever it is called."""
    return {
        "checkpoint": probe.checkpoint,
        "overrides": dict(probe.overrides),
        "alpha": probe.alpha,
    }


def is_probed(
    run: Path, probe: Probe, goals: int, overrides: Mapping[str, Any]
) -> bool:
    """Whether a run has been evaluated so.

    Args:
        run: Its folder.
        probe: How.
        goals: On how many.
        overrides: Of the task, beside the probe's.
    """
    path = probe_file(run, probe)
    if not path.exists():
        return False
    known = json.loads(path.read_text())
    return (
        len(known["episodes"]) == goals
        and known["overrides"] == as_json({**overrides, **probe.overrides})
        and (probe == LAST or known.get("probe") == as_json(probe_way(probe)))
    )


class RowStore:
    """Rows in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def missing(
        self,
        cell: Cell,
        seeds: Sequence[int],
        probes: Sequence[Probe],
        made_of: Mapping[str, Any],
    ) -> list[int]:
        """Seeds of which there are not the rows of all these probes.

        Args:
            cell: What the rows are of.
            seeds: Those that are wanted.
            probes: Likewise.
            made_of: What there is must have been made so.

        Raises:
            OtherConfigError: If there are rows of runs of another config.
        """
        path = self._path(cell, ".json")
        if not path.exists():
            return list(seeds)
        known = json.loads(path.read_text())
        ways = {probe.name: probe_way(probe) for probe in probes}
        there = {name: ways[name] for name in ways if name in known["probes"]}
        refuse_other_config(path, known, {**made_of, "probes": there})
        pairs = {(row["seed"], row["probe"]) for row in self._rows(cell)}
        return [seed for seed in seeds if not pairs >= set(product([seed], ways))]

    def check_dataset(self, cell: Cell, identity: Mapping[str, Any]) -> None:
        """Raise if there are rows of runs that learnt from other data.

        Raises:
            OtherConfigError: Saying what differs.
        """
        path = self._path(cell, ".json")
        if path.exists():
            known = json.loads(path.read_text())
            refuse_other_config(path, known, {"dataset": _bytes_of(identity)})

    def keep(
        self, cell: Cell, runs: Mapping[int, Path], probes: Sequence[Probe]
    ) -> None:
        """Take the rows of finished runs; those of other seeds and probes stay.

        Args:
            cell: What they are of.
            runs: Their folders, by seed.
            probes: Evaluations that they have.
        """
        with only_here(self.folder, wait=True):  # others may add to the same cell
            self._keep(cell, runs, probes)

    def _keep(
        self, cell: Cell, runs: Mapping[int, Path], probes: Sequence[Probe]
    ) -> None:
        rows = [
            row
            for seed, run in runs.items()
            for probe in probes
            for row in _evaluation(run, seed, probe)
        ]
        path = self._path(cell, ".json")
        known = json.loads(path.read_text()) if path.exists() else {}
        ways = known.get("probes", {})
        ways |= {probe.name: probe_way(probe) for probe in probes}
        new = {(row["seed"], row["probe"]) for row in rows}
        kept = [r for r in self._rows(cell) if (r["seed"], r["probe"]) not in new]
        rows += kept
        rows.sort(key=lambda r: (r["seed"], r["probe"], r["goal"]))
        ways = dict(sorted(ways.items()))  # whoever came first
        curve = [row for seed, run in runs.items() for row in _curve(run, seed)]
        curves = self._curves(cell)
        again = {row["seed"] for row in kept} & set(runs)
        self._check_same_training(cell, again, as_read(curve), curves)
        curve += [row for row in curves if row["seed"] not in runs]
        curve.sort(key=lambda row: (row["seed"], row["step"]))
        config = json.loads((next(iter(runs.values())) / "config.json").read_text())
        for key in ("seed", "preset", "device"):
            config.pop(key)
        if {row["seed"] for row in rows} - set(runs):
            self.check_dataset(cell, config["dataset"])
        config["dataset"] = _bytes_of(config["dataset"])
        ends = {s: u for s, u in self.diverged(cell).items() if s not in runs}
        for seed, run in runs.items():
            step = read_metrics(run)[-1]["step"]
            if step < config["updates"]:
                ends[seed] = step
        diverged = {str(seed): ends[seed] for seed in sorted(ends)}
        write_json(path, {"probes": ways, "diverged": diverged, **config})
        write_csv(self._path(cell, ".curve.csv.gz"), curve)
        write_csv(self._path(cell, ".csv.gz"), rows)  # last: without, it is missing

    def _check_same_training(
        self, cell: Cell, seeds: Collection[int], new: list[Row], known: list[Row]
    ) -> None:
        """Raise if rows that stay are of a training that learnt something else."""
        for seed in seeds:
            curves = [[r for r in rows if r["seed"] == seed] for rows in (new, known)]
            if curves[1] and repr(curves[0]) != repr(curves[1]):  # nan is not nan
                raise MarlMmError(
                    f"{self._path(cell, '.csv.gz')} has other evaluations of seed "
                    f"{seed}, of a training with another learning curve: name another "
                    "folder with --out, or delete the cell's three files"
                )

    def evaluations(
        self, cell: Cell, seeds: Sequence[int], probes: Sequence[Probe]
    ) -> list[Row]:
        """A row per seed, probe and goal.

        Raises:
            UsageError: If there are none.
        """
        names = [probe.name for probe in probes]
        rows = [
            row
            for row in self._rows(cell)
            if row["seed"] in seeds and row["probe"] in names
        ]
        if {(row["seed"], row["probe"]) for row in rows} != {
            (seed, name) for seed in seeds for name in names
        }:
            raise UsageError(
                f"{self._path(cell, '.csv.gz')} lacks rows of seeds "
                f"{', '.join(map(str, seeds))} and {', '.join(names)}: marl-mm ablate "
                "without --check makes what is missing"
            )
        return rows

    def curves(self, cell: Cell, seeds: Sequence[int]) -> list[Row]:
        """A row per seed and point of the learning curve.

        Raises:
            UsageError: If there are none of a seed.
        """
        rows = [row for row in self._curves(cell) if row["seed"] in seeds]
        if {row["seed"] for row in rows} != set(seeds):
            raise UsageError(
                f"{self._path(cell, '.curve.csv.gz')} lacks rows of seeds "
                f"{', '.join(map(str, seeds))}: marl-mm ablate without --check makes "
                "what is missing"
            )
        return rows

    def diverged(self, cell: Cell) -> dict[int, int]:
        """Updates after which runs diverged, by seed; what they had learnt counts."""
        path = self._path(cell, ".json")
        known = json.loads(path.read_text()) if path.exists() else {}
        return {int(seed): step for seed, step in known.get("diverged", {}).items()}

    def _rows(self, cell: Cell) -> list[Row]:
        path = self._path(cell, ".csv.gz")
        return read_rows(path) if path.exists() else []

    def _curves(self, cell: Cell) -> list[Row]:
        path = self._path(cell, ".curve.csv.gz")
        return read_rows(path) if path.exists() else []

    def _path(self, cell: Cell, end: str) -> Path:
        dataset, setting = cell
        return self.folder / dataset.replace("/", "-") / f"{setting.name}{end}"


def _bytes_of(identity: Mapping[str, Any]) -> dict[str, Any]:
    """What a dataset is, wherever it lies."""
    return {key: value for key, value in identity.items() if key != "path"}


def _evaluation(run: Path, seed: int, probe: Probe) -> Iterator[Row]:
    evaluation = json.loads(probe_file(run, probe).read_text())
    for row in evaluation["episodes"]:
        yield {
            "seed": seed,
            "probe": probe.name,
            "goal": row["index"],
            "direction": row["direction"],
            "success": int(row["success"]),
            **{key: row[key] for key in _MEASURED},
            **{key: row[key] for key in ("reason",) if key in row},
        }


def _curve(run: Path, seed: int) -> Iterator[Row]:
    for row in read_metrics(run):
        if "success/all" in row:
            # A single goal is ahead.
            own = {key.replace("/", "_"): row.get(key, math.nan) for key in _CURVE}
            yield {"seed": seed, "step": row["step"], **own}
