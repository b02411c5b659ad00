"""Rows of online runs: from their folders, or from files."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from marl_mm.commands.ablate_runs import Ablate, train_missing
from marl_mm.errors import UsageError
from marl_mm.eval.metrics import Row
from marl_mm.eval.online import curve_rows
from marl_mm.eval.rows import as_read, read_rows

CURVES = "curves.csv.gz"


def best_run(options: Ablate, name: str) -> Path:
    """The seed whose best policy was best by its learning curve's own goals."""
    curves = curves_of(options, [name])  # max takes the first of equals
    best = max(curves, key=lambda row: (row["success_all"], row["return_all"]))
    return options.runs_folder() / name / str(best["seed"])


def curves_of(options: Ablate, names: Sequence[str]) -> list[Row]:
    """Learning curves of settings."""
    return rows_of(options, CURVES, names, curve_rows)


def rows_of(
    options: Ablate,
    file: str,
    names: Sequence[str],
    of_run: Callable[[Path, str, int], Iterable[Row]],
) -> list[Row]:
    """Rows of settings, from runs or from a file, but with the digits of a file."""
    if options.rows is None:
        train_missing(options, names)
        runs = options.runs_folder()
        cells = [(name, seed) for name in names for seed in options.seeds]
        return as_read([row for cell in cells for row in of_run(runs, *cell)])
    path = options.rows / file
    if not path.exists():
        raise UsageError(f"there is no {path} to draw from")
    found = [row for row in read_rows(path) if row["setting"] in names]
    rows = [row for row in found if row["seed"] in options.seeds]
    missing = set(names) - {row["setting"] for row in rows}
    if missing:
        raise UsageError(f"{path} has no rows of {', '.join(sorted(missing))}")
    return rows
