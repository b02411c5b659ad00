"""Cells of studies that train nothing: each is run once, and its rows are kept."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar, cast

import marl_mm
from marl_mm import plugins
from marl_mm.config_diff import as_json, changes
from marl_mm.envs.registry import TASKS, config_dict, make_task
from marl_mm.errors import MarlMmError, OtherConfigError, UsageError
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import as_read, read_rows, write_csv
from marl_mm.files import write_json
from marl_mm.progress import Bar
from marl_mm.received import check_kind, read_json
from marl_mm.versions import versions
from marl_mm.workers import Executor, open_pool


class ActedCell(Protocol):
    """Everything that a cell's rows depend on: a frozen dataclass."""

    @property
    def task(self) -> str:
        """Registered name of the task."""

    @property
    def overrides(self) -> dict[str, Any]:
        """Settings of the task that are replaced."""

    @property
    def label(self) -> str:
        """Label in the progress bar."""


C = TypeVar("C", bound=ActedCell)


def run_cells(
    run: Callable[[C], list[Row]],
    cells: Sequence[C],
    folder: Path,
    workers: int,
    advance_of: tuple[Bar, str],
    executor: Executor = "local",
    groups: Mapping[Path, Sequence[C]] = MappingProxyType({}),
) -> dict[C, list[Row]]:
    """Rows of cells; those that are finished are kept in a folder.

    Args:
        run: Function of a cell that returns its rows.
        cells: The cells.
        folder: Folder of the kept rows, a file per cell.
        workers: Number of processes.
        advance_of: Factory of progress bars, and the bar's label.
        executor: Processes of this machine, or of a Ray cluster that shares its files.
        groups: Cells by the path of ``write_cells``, which writes each group as soon as
            it is whole.

    Raises:
        KeyboardInterrupt: After Ctrl-C, saying how to go on.
    """
    rows, unwritten = kept_rows(cells, folder), dict(groups)

    def write_whole() -> None:
        for path, group in [*unwritten.items()]:
            if all(cell in rows for cell in group):
                write_cells(path, group, rows)
                del unwritten[path]

    write_whole()
    missing = [cell for cell in cells if cell not in rows]
    bar, label = advance_of
    advance = bar(label, len(cells))
    advance(len(rows), "")
    pool = open_pool(executor, workers, None, ())
    try:
        # As they are ready, so that no worker waits for a slower one.
        for cell, values in pool.completed(_Run(run), missing, ahead=1):
            rows[cell] = as_read(values)
            write_json(_file(cell, folder), values)
            write_whole()
            advance(1, cell.label)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted with {len(rows)} of {len(cells)} settings done; "
            "`resume=True` goes on from there"
        ) from None
    finally:
        pool.close()
    return rows


@dataclass(frozen=True)
class _Run(Generic[C]):
    """A cell and its rows."""

    run: Callable[[C], list[Row]]

    def __call__(self, cell: C) -> tuple[C, list[Row]]:
        return cell, self.run(cell)


def write_cells(path: Path, cells: Sequence[C], rows: dict[C, list[Row]]) -> None:
    """Write the rows of a task's cells, and what they are made of.

    Args:
        path: Path without its ending: ``.csv.xz`` and ``.json``.
        cells: Cells of the task.
        rows: Rows by cell.
    """
    about = [asdict(cast(Any, cell)) for cell in cells]
    ours = [row for cell in cells for row in rows[cell]]
    write_csv(path.with_name(f"{path.name}.csv.xz"), ours)
    write_json(record_of(path), {"cells": about, "packages": versions()})


def record_of(path: Path) -> Path:
    """File that says what rows are made of, by their path without its ending."""
    return path.with_name(f"{path.name}.json")


def recorded_cells(path: Path) -> list[dict[str, Any]]:
    """Cells that rows are made of, by their path without its ending; none without.

    Raises:
        MarlMmError: If the record is damaged.
    """
    record = record_of(path)
    if not record.exists():
        return []
    about = read_json(record, MarlMmError)
    check_kind(about, dict[str, Any], str(record), MarlMmError)
    cells: list[dict[str, Any]] = about.get("cells", [])
    check_kind(cells, list[dict[str, Any]], f"{record}: cells", MarlMmError)
    return cells


def missing_groups(
    groups: Mapping[Path, Sequence[C]], overwrite: bool
) -> dict[Path, Sequence[C]]:
    """Groups of which rows are not there; those of older code count.

    Args:
        groups: Cells by the path of ``write_cells``.
        overwrite: Whether rows of other cells may be replaced.

    Raises:
        OtherConfigError: If rows of other cells would be lost, naming what differs.
    """
    missing = {}
    for path, cells in groups.items():
        wanted = [asdict(cast(Any, cell)) for cell in cells]
        wanted, made = as_json({"cells": wanted})["cells"], recorded_cells(path)
        if all(cell in made for cell in wanted):
            continue
        lost = [cell for cell in made if cell not in wanted]
        if lost and not overwrite:
            like = min(wanted, key=lambda cell: len([*changes(lost[0], cell)]))
            words = ", ".join(changes(lost[0], like)) or "other settings"
            raise OtherConfigError(
                f"{record_of(path)} was made with {words:.300}",
                "name another folder with `out`, or replace it with `overwrite=True`",
            )
        missing[path] = cells
    return missing


def read_cells(folder: Path) -> dict[str, list[Row]]:
    """Rows that ``write_cells`` wrote, by the task's name, in the names' order.

    Raises:
        UsageError: If there are none.
    """
    paths = sorted(folder.glob("*.csv.xz"))
    if not paths:
        raise UsageError(f"there are no rows in {folder} to draw from")
    return {path.name.removesuffix(".csv.xz"): read_rows(path) for path in paths}


def kept_rows(cells: Sequence[C], folder: Path) -> dict[C, list[Row]]:
    """Rows of the cells that are finished; arguments are those of ``run_cells``."""
    kept = {cell: _read(_file(cell, folder)) for cell in cells}
    return {cell: rows for cell, rows in kept.items() if rows is not None}


def _file(cell: Any, folder: Path) -> Path:
    """File named by the SHA-256 of all that rows depend on: settings, sources."""
    config = config_dict(make_task(cell.task, cell.overrides))
    added = plugins.record(TASKS.origin(cell.task))
    made_of = asdict(cell), config, _sources(), versions(), added
    return folder / f"{sha256(json.dumps(made_of).encode()).hexdigest()}.json"


@cache
def _sources() -> str:
    """SHA-256 of what decides what is learnt, what an episode is and what is measured.

    That is sources, the robot's description, and the weights and data that ship.
    """
    package, digest = Path(marl_mm.__file__).parent, sha256()
    folders = (
        *("algorithms", "collectors", "control", "datasets", "envs", "robot"),
        *("runs", "sim"),
    )
    patterns = [f"{folder}/**/*" for folder in folders]
    for pattern in (*patterns, "eval/*", "eval/studies/*", "*"):
        for path in sorted(package.glob(pattern)):
            if path.suffix in (".py", ".urdf", ".safetensors", ".npz"):
                digest.update(path.read_bytes())
    return digest.hexdigest()


def _read(file: Path) -> list[Row] | None:
    """A finished cell's rows, if they are there."""
    try:
        return as_read(json.loads(file.read_text("utf-8")))
    except (OSError, ValueError):
        return None
