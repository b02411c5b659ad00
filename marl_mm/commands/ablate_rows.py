"""Rows of online runs: from their folders, or from files."""

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from marl_mm.commands.ablate_runs import Ablate, train_missing
from marl_mm.config_diff import refuse_other_config
from marl_mm.errors import OtherConfigError, UsageError
from marl_mm.eval.metrics import Row
from marl_mm.eval.online import MADE_OF, SETTINGS, curve_rows
from marl_mm.eval.rows import as_read, read_rows, write_csv
from marl_mm.files import write_json
from marl_mm.runs.folder import read_config

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
    found = [row for row in read_rows(path) if row["setting"] in names]
    rows = [row for row in found if row["seed"] in options.seeds]
    there = {(row["setting"], row["seed"]) for row in rows}
    missing = [
        f"{name} {seed}"
        for name in names
        for seed in options.seeds
        if (name, seed) not in there
    ]
    if missing:
        raise UsageError(f"{path} has no rows of {', '.join(missing)}")
    return rows


def keep_made_of(options: Ablate, names: Sequence[str]) -> None:
    """Add what runs were made of; nothing to be known without their folders.

    Raises:
        OtherConfigError: If there are rows of runs that were made of something else.
    """
    if options.rows is not None:
        return
    path = options.results(MADE_OF)
    known = json.loads(path.read_text()) if path.exists() else {}
    for name in names:
        run = options.runs_folder() / name / str(options.seeds[0])
        config = read_config(run).to_json()
        del config["seed"]
        packages = config.pop("packages")
        if config.get("dataset"):
            del config["dataset"]["path"]
        try:
            refuse_other_config(
                options.results(CURVES), known.get(name, config), config
            )
        except OtherConfigError as error:
            advice = "name another folder with --out"
            raise OtherConfigError(error.difference, advice) from error
        known[name] = {**config, "packages": packages}
    write_json(path, known)


def keep_rows(path: Path, rows: Sequence[Row]) -> None:
    """Add rows to a file: they replace those of their settings and seeds."""
    new = {(row["setting"], row["seed"]) for row in rows}
    before = read_rows(path) if path.exists() else []
    kept = [row for row in before if (row["setting"], row["seed"]) not in new]
    order = {setting.name: number for number, setting in enumerate(SETTINGS)}
    rows = [*as_read(rows), *kept]
    rows.sort(key=lambda row: (order.get(row["setting"], len(order)), row["seed"]))
    write_csv(path, rows)
