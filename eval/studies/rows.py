"""Evaluations and learning curves of runs, as the rows that tables are made of.

Three files for each cell::

    ROWS/SOURCE/SETTING.csv.xz         a line per seed, probe and goal
    ROWS/SOURCE/SETTING.curve.csv.xz   a line per seed and point of the learning curve
    ROWS/SOURCE/SETTING.json           the record of what the runs were made of

Older rows, whose names end in ``.csv.gz``, are read too.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import asdict, dataclass
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import Any

from marl_mm.algorithms.fine_tuning import FineTuning
from marl_mm.config_diff import as_json, changes, refuse_other_config
from marl_mm.declared import with_added
from marl_mm.errors import MarlMmError, OtherConfigError, UsageError
from marl_mm.eval.grouping import grouped
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import as_read, has_rows, read_rows, write_csv
from marl_mm.eval.studies.run_rows import curve_of, diverged_at, goals_of
from marl_mm.eval.studies.settings import Online, Probe
from marl_mm.eval.studies.study import Cell, cell_name
from marl_mm.files import only_here, write_json
from marl_mm.received import check_kind, read_json
from marl_mm.runs.sources import Data, Mix, Source, engine_named_by
from marl_mm.runs.training import SWITCHES
from marl_mm.sim.config import ENGINES, RECORDED_ENGINE, Engine, default_engine
from marl_mm.versions import engine_text

_ADVICE = "name another folder with `out`"
"""Advice if rows are of runs with another config."""

_ANY = {"packages", "precision"}
"""Values of records in which the seeds of a cell may differ."""

_ALIKE = "eval_seed", "eval_episodes", "max_steps", "updates", "engine", "task"
"""Values in which the cells of a table may not differ, beside the bytes of the data."""

_CURVES = ".curve.csv.xz"
"""Suffix of files with a cell's learning curves."""


@dataclass(frozen=True)
class RowStore:
    """Rows in a folder."""

    folder: Path
    """Folder of the cells' files."""

    def missing(
        self,
        cell: Cell,
        seeds: Sequence[int],
        probes: Sequence[Probe],
        made_of: Mapping[str, Any],
        settings: Any,
    ) -> list[int]:
        """Seeds without the rows of all these probes.

        Args:
            cell: The cell.
            seeds: Seeds asked for.
            probes: Evaluations asked for.
            made_of: Config that rows must have been made with.
            settings: Hyper-parameters that are part of it.

        Raises:
            OtherConfigError: If there are rows of runs that were not made of this.
        """
        path, record = self._path(cell, ".json"), self._record(cell)
        if not record:
            return list(seeds)
        ways = {probe.name: probe.way for probe in probes}
        known = record.get("probes", {})
        for name in ways.keys() & known.keys():
            _refuse_unlike(path, f"probes.{name}", known[name], ways[name])
        if "source" in record:  # which older ones lack
            _refuse_unlike(path, "source", record["source"], _declared(cell))
        recorded = dict(made_of) if "algorithm" in record else {}  # older ones lack it
        if recorded:  # these stand there only where they are not the default
            usual = {"max_steps": None, **asdict(FineTuning())}
            recorded = {k: v for k, v in usual.items() if k in record} | recorded
        begun, current = (with_added(of, settings) for of in (record, recorded))
        refuse_other_config(path, begun, current, _ADVICE)
        pairs = {(row["seed"], row["probe"]) for row in self._rows(cell)}
        left = [seed for seed in seeds if not pairs >= set(product([seed], ways))]
        engine = record.get("engine")
        if left and engine and "packages" in record:
            before, present = self.engine_text(cell, engine), engine_text(engine)
            if before != present:
                words = f"{path} was made with {before} (now {present})"
                raise OtherConfigError(words, _ADVICE)
        return left

    def seeds(self, cell: Cell) -> list[int]:
        """Seeds of a cell's rows; none without rows."""
        return sorted({row["seed"] for row in self._rows(cell)})

    def engines(
        self, cells: Sequence[Cell], asked: Engine | None
    ) -> dict[tuple[str, str], Engine]:
        """Engine of each cell, by the cell's names.

        A cell whose source names an engine has that one. All others share one: what is
        asked for, else that of their rows, else the default.

        Raises:
            UsageError: If a cell has rows of another engine, or the others' rows are of
                several.
        """
        named = {cell_name(cell): _engine_named(cell[0]) for cell in cells}
        recorded = {cell_name(cell): self._engine(cell) for cell in cells}
        unnamed = sorted({e for name, e in recorded.items() if e if not named[name]})
        if asked is None and len(unnamed) > 1:
            raise UsageError(
                f"{self.folder} has rows of engines {' and '.join(unnamed)}, expected "
                f"one in a table: choose it with `engine`, and {_ADVICE}"
            )
        shared = asked or (unnamed[0] if unnamed else default_engine())
        for cell in cells:
            name = cell_name(cell)
            engine, wanted = recorded[name], named[name] or shared
            if engine not in (None, wanted):
                raise UsageError(
                    f"{self._path(cell, '.csv.xz')} is of engine {engine}, expected "
                    f"{wanted}: {_ADVICE}, or the rows' engine with `engine`"
                )
        return {name: named[name] or shared for name in recorded}

    def engine_text(self, cell: Cell, engine: Engine) -> str:
        """An engine with its version when a cell was made; empty in older rows."""
        record = self._record(cell)
        return (
            engine_text(engine, record.get("packages", {}))
            if "engine" in record
            else ""
        )

    def _engine(self, cell: Cell) -> Engine | None:
        """Engine of a cell's rows; None without rows."""
        record = self._record(cell)
        engine = record.get("engine", RECORDED_ENGINE) if record else None
        if engine not in (None, *ENGINES):
            raise MarlMmError(
                f"{self._path(cell, '.json')} is damaged: engine is {engine!r:.60}"
            )
        return engine

    def refuse_mixed(self, cells: Sequence[Cell], but: str = "") -> None:
        """Raise for rows of a table that differ in data, goals, updates or engine.

        Args:
            cells: Cells of the rows.
            but: Name of the value in which they may differ.

        Raises:
            OtherConfigError: Naming the first cell that differs, and in what.
        """
        first, *others = [self._record(cell) for cell in cells]
        for cell, record in zip(cells[1:], others, strict=True):
            begun, now = (
                {"fingerprint": (of.get("dataset") or {}).get("fingerprint")}
                | {key: of.get(key) for key in _ALIKE if key != but}
                for of in (first, record)
            )
            if words := ", ".join(changes(now, begun)):
                path = self._path(cell, ".json")
                why = f"{path} was made otherwise than other rows of its table: {words}"
                raise OtherConfigError(why, _ADVICE)

    def check_dataset(self, cell: Cell, identity: Mapping[str, Any]) -> None:
        """Raise if there are rows of runs that learnt from other data.

        Raises:
            OtherConfigError: Naming what differs.
        """
        if (record := self._record(cell)).get("dataset"):
            current = {"dataset": _bytes_of(identity)}
            refuse_other_config(self._path(cell, ".json"), record, current, _ADVICE)

    def keep(
        self, cell: Cell, runs: Mapping[int, Path], probes: Sequence[Probe]
    ) -> None:
        """Take the rows of finished runs, by seed; those of others stay.

        Raises:
            MarlMmError: If rows that stay are of another training.
        """
        with only_here(self.folder, wait=True):  # others may add to the same cell
            self._keep(cell, runs, probes)

    def _keep(
        self, cell: Cell, runs: Mapping[int, Path], probes: Sequence[Probe]
    ) -> None:
        pairs = product(runs.items(), probes)
        measured = cell[1].measured
        new = [
            r for (s, run), probe in pairs for r in goals_of(run, s, probe, measured)
        ]
        made = set(product(runs, [probe.name for probe in probes]))
        kept = [r for r in self._rows(cell) if (r["seed"], r["probe"]) not in made]
        rows = sorted(new + kept, key=itemgetter("seed", "probe", "goal"))
        curve = [row for seed, run in runs.items() for row in curve_of(run, seed)]
        curves = self._rows(cell, _CURVES)
        again = {row["seed"] for row in kept} & set(runs)
        self._check_same_training(cell, again, as_read(curve), curves)
        curve += [row for row in curves if row["seed"] not in runs]
        curve.sort(key=lambda row: (row["seed"], row.get("step", row.get("episode"))))
        ways = self._record(cell).get("probes", {})
        ways |= {probe.name: probe.way for probe in probes}
        config = read_json(next(iter(runs.values())) / "config.json", MarlMmError)
        for key in ("seed", "preset", "device", *SWITCHES):
            config.pop(key, None)
        if config["dataset"]:
            config["dataset"] = _bytes_of(config["dataset"])
        if {row["seed"] for row in rows} - set(runs):  # others stay, of the same
            begun, now = (
                with_added(of, cell[1].config) for of in (self._record(cell), config)
            )
            same = {k: now[k] for k in now.keys() & begun.keys() - _ANY}
            refuse_other_config(self._path(cell, ".json"), begun, same, _ADVICE)
        ends = {s: u for s, u in self.diverged(cell).items() if s not in runs}
        for seed, run in runs.items():
            if (step := diverged_at(run, config)) is not None:
                ends[seed] = step
        record = {
            "probes": dict(sorted(ways.items())),  # in order, whichever run came first
            "diverged": {str(seed): ends[seed] for seed in sorted(ends)},
            **({"source": declared} if (declared := _declared(cell)) else {}),
            **config,
        }
        write_json(self._path(cell, ".json"), record)
        write_csv(self._path(cell, _CURVES), curve)
        write_csv(self._path(cell, ".csv.xz"), rows)  # last: without, it is missing

    def _check_same_training(
        self, cell: Cell, seeds: Set[int], new: list[Row], kept: list[Row]
    ) -> None:
        """Raise if rows that stay are of a training with another learning curve."""
        of_new, of_kept = grouped(new, "seed"), grouped(kept, "seed")
        for seed in seeds & of_kept.keys():
            if _filled(of_new.get(seed, [])) != _filled(of_kept[seed]):
                raise MarlMmError(
                    f"{self._path(cell, '.csv.xz')} has other evaluations of seed "
                    f"{seed}, of a training with another learning curve: name another "
                    "folder with `out`, or delete the cell's three files"
                )

    def evaluations(
        self, cell: Cell, seeds: Sequence[int], probes: Sequence[Probe]
    ) -> list[Row]:
        """A row per seed, probe and goal; a UsageError if some are missing."""
        wanted = set(product(seeds, [probe.name for probe in probes]))
        rows = [r for r in self._rows(cell) if (r["seed"], r["probe"]) in wanted]
        if {(r["seed"], r["probe"]) for r in rows} != wanted:
            raise self._lacking(cell, ".csv.xz", seeds)
        return rows

    def curves(self, cell: Cell, seeds: Sequence[int]) -> list[Row]:
        """A row per seed and point of its learning curve; a UsageError if some lack."""
        rows = [r for r in self._rows(cell, _CURVES) if r["seed"] in seeds]
        if {row["seed"] for row in rows} != set(seeds):
            raise self._lacking(cell, _CURVES, seeds)
        return rows

    def _lacking(self, cell: Cell, end: str, seeds: Sequence[int]) -> UsageError:
        return UsageError(
            f"{self._path(cell, end)} lacks rows of seeds "
            f"{', '.join(map(str, seeds))}: marl-mm ablate without --check makes what "
            "is missing"
        )

    def diverged(self, cell: Cell) -> dict[int, int]:
        """Updates after which runs diverged, by seed; what they had learnt counts."""
        steps = self._record(cell).get("diverged", {})
        return {int(seed): step for seed, step in steps.items()}

    def _rows(self, cell: Cell, end: str = ".csv.xz") -> list[Row]:
        path = self._path(cell, end)
        rows = read_rows(path) if has_rows(path) else []
        kinds = {"seed": int} | ({} if end == _CURVES else {"probe": int | float | str})
        for number, row in enumerate(rows, 1):
            for name, kind in kinds.items():
                if not isinstance(row.get(name), kind):
                    raise MarlMmError(f"{path} is damaged: row {number} has no {name}")
        return rows

    def _record(self, cell: Cell) -> dict[str, Any]:
        path = self._path(cell, ".json")
        record = read_json(path, MarlMmError) if path.exists() else {}
        check_kind(record, dict[str, Any], str(path), MarlMmError)
        kind = dict[str, dict[str, Any]]
        check_kind(record.get("probes", {}), kind, str(path), MarlMmError)
        ends = record.get("diverged", {})
        check_kind(ends, dict[str, float], str(path), MarlMmError)
        if not all(seed.isdecimal() for seed in ends):
            raise MarlMmError(f"{path} is damaged: `diverged` is not by seed")
        return dict(record)

    def _path(self, cell: Cell, end: str) -> Path:
        source, setting = cell_name(cell)
        return self.folder / source.replace("/", "-") / f"{setting}{end}"


def _declared(cell: Cell) -> dict[str, Any] | None:
    """What a cell's dataset is declared as; None of one that is only named."""
    source = cell[0].demonstrations if isinstance(cell[0], Online) else cell[0]
    return as_json(asdict(source)) if isinstance(source, Source | Mix) else None


def _refuse_unlike(path: Path, what: str, before: Any, now: Any) -> None:
    """Raise an OtherConfigError where a recorded value is not that of now."""
    now = as_json(now or {})
    if now != before:
        absent = {key: None for key in before}
        words = ", ".join(changes(before, {**absent, **now}, f"{what}."))
        words = words or f"{what} = {before} (now {now})"  # a nested one is gone
        raise OtherConfigError(f"{path} was made with {words}", _ADVICE)


def _engine_named(source: Data | Online) -> Engine | None:
    """Engine that a source names; None where it leaves that open."""
    data = source.demonstrations if isinstance(source, Online) else source
    return None if data is None else engine_named_by(data)


def _filled(rows: Sequence[Row]) -> str:
    """Text of rows without their empty cells, in which nan equals nan."""
    return repr([{n: v for n, v in row.items() if v != ""} for row in rows])


def _bytes_of(identity: Mapping[str, Any]) -> dict[str, Any]:
    """Identity of a dataset without its path."""
    return {key: value for key, value in identity.items() if key != "path"}
