"""marl-mm sweep-alpha: what alpha does, in tables and figures."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.collectors.pd import PdConfig
from marl_mm.commands.ablate_check import check_tables
from marl_mm.commands.parser import parse_options
from marl_mm.control.config import FORMS, Form
from marl_mm.envs.registry import config_dict, make_task
from marl_mm.errors import UsageError
from marl_mm.eval.figures import alpha_pareto, alpha_response, load_response
from marl_mm.eval.load_sweep import load_cells, run_load_cell, summarize_loads
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import as_read, read_rows, write_csv
from marl_mm.eval.sweep import (
    LONG_EPISODE,
    RUNS,
    SHORT_EPISODE,
    SweepCell,
    responses,
    run_cell,
    summarize_cells,
    worth_of_a_rule,
)
from marl_mm.eval.sweep_tables import sweep_markdown
from marl_mm.files import new_folder, refuse_existing, write_json
from marl_mm.jit import source_fingerprint
from marl_mm.progress import progress_bar
from marl_mm.runs.settings import check_positive, check_seed
from marl_mm.versions import versions
from marl_mm.workers import available_cores, ordered_map

RULES = (PdConfig(alpha_rule="direction"), PdConfig(alpha_rule="room"))
"""State-dependent alphas, compared with every fixed one on SmoothReach-v0."""

SMOOTH = "SmoothReach-v0"

EPISODES, LOAD_EPISODES = "episodes.csv.gz", "load_episodes.csv.gz"

FINE = 0.05
"""Step of the fixed alphas they are compared with."""


@dataclass(frozen=True)
class SweepAlpha:
    """Run the PD agent at fixed alphas, with rules that choose alpha, and with loads.

    Writes figures (response.png, pareto.png, loads.png), means (alpha.csv, worth.csv,
    loads.csv) and every episode (episodes.csv.gz, load_episodes.csv.gz). Takes about
    twenty minutes on two cores, and some more for the loads.
    """

    out: Path = Path("runs/alpha")
    """Folder of the results."""

    tasks: tuple[str, ...] = tuple(task for tasks in RUNS.values() for task in tasks)
    """Reach-v0, SmoothReach-v0, PreciseReach-v0."""

    forms: tuple[Form, ...] = FORMS
    """How alpha enters the controller: blend, rhp, rhp-literal."""

    goals: int = 48
    """Per alpha, half ahead and half behind."""

    alphas: int = 11
    """Evenly spaced from 0 to 1."""

    seed: int = 0
    """Of the goals."""

    worth_goals: int = 96
    """For comparing rules with fixed alphas, on goals of the next seed; 0: none."""

    load_goals: int = 24
    """Per mass and alpha, for CarryReach-v0 with 0.1 to 3 kg in the hand; 0: none."""

    workers: int = field(default_factory=available_cores)
    """Processes; the result does not depend on it."""

    resume: bool = False
    """Keep what an interrupted sweep has finished."""

    overwrite: bool = False
    """Replace OUT if it exists."""

    check: bool = False
    """Only say whether tables in OUT are what its rows give, to the byte."""

    json: bool = False
    """Print the means as JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm sweep-alpha``."""
    options = parse_options(SweepAlpha, "marl-mm sweep-alpha", arguments)
    check_positive(goals=options.goals, workers=options.workers)
    check_seed(options.seed)
    for name in ("goals", "worth_goals", "load_goals"):
        goals = getattr(options, name)
        if goals < 0 or goals % 2:
            option = name.replace("_", "-")
            raise UsageError(
                f"--{option} is {goals}, expected an even number: half ahead, half "
                "behind"
            )
    if options.alphas < 2:
        raise UsageError(f"--alphas is {options.alphas}, expected >= 2")
    _check_known(
        "--tasks", options.tasks, [t for tasks in RUNS.values() for t in tasks]
    )
    _check_known("--forms", options.forms, FORMS)
    if options.check:
        check_sweep(options.out)
        return
    refuse_existing(options.out, options.overwrite)
    rows, load_rows = map(as_read, _run(options))
    with new_folder(options.out) as folder:
        write_csv(folder / EPISODES, rows)
        if load_rows:
            write_csv(folder / LOAD_EPISODES, load_rows)
        result, text = _draw(folder, rows, load_rows)
        write_json(folder / "config.json", _described(options))
    shutil.rmtree(_cells_folder(options.out), ignore_errors=True)
    print(json.dumps(result, indent=2) if options.json else f"{text}\n{options.out}")


def check_sweep(out: Path) -> None:
    """Print of every file of a sweep whether it is what its rows give.

    Raises:
        UsageError: If there are no rows.
        MarlMmError: If a file is another.
    """
    loads = out / LOAD_EPISODES
    rows, load_rows = read_rows(out / EPISODES), []
    files = ["alpha.csv"]
    if any(row["max_steps"] == SHORT_EPISODE for row in rows):
        files.append("worth.csv")
    if loads.exists():
        load_rows = read_rows(loads)
        files.append("loads.csv")
    check_tables(out, files, lambda folder: _draw(folder, rows, load_rows))


def _draw(
    folder: Path, rows: Sequence[Row], load_rows: Sequence[Row]
) -> tuple[dict[str, Any], str]:
    """All tables and figures, from rows; returns the means, and the text."""
    long, short = (
        [row for row in rows if row["max_steps"] == steps]
        for steps in (LONG_EPISODE, SHORT_EPISODE)
    )
    summary, loads = summarize_cells(long), summarize_loads(load_rows)
    answer = responses(summary)
    worth = worth_of_a_rule(short, SMOOTH) if short else []
    text = sweep_markdown(summary, answer, worth, loads)
    write_csv(folder / "alpha.csv", summary)
    alpha_response(summary, folder / "response.png")
    alpha_pareto(summary, folder / "pareto.png")
    if worth:
        write_csv(folder / "worth.csv", worth)
    if loads:
        write_csv(folder / "loads.csv", loads)
        load_response(loads, folder / "loads.png")
    means = {
        "alphas": summary,
        "responses": [asdict(one) for one in answer],
        "worth": worth,
        "loads": loads,
    }
    return means, text


def _check_known(option: str, given: Sequence[str], known: Sequence[str]) -> None:
    unknown = [name for name in given if name not in known]
    if unknown or not given:
        raise UsageError(
            f"{option} is {' '.join(given) or 'empty'}, expected some of "
            f"{', '.join(known)}"
        )


def _run(options: SweepAlpha) -> tuple[list[Row], list[Row]]:
    """Rows of the sweep and for the worth of a rule, and those with loads."""
    sweep, worth = _cells(options), _worth_cells(options)
    carried = load_cells(options.load_goals, options.seed) if options.load_goals else []
    folder = _cells_folder(options.out)
    if not options.resume:
        shutil.rmtree(folder, ignore_errors=True)
    cells = [*sweep, *worth, *carried]
    rows: dict[SweepCell, list[Row]] = {}
    for cell in cells:
        found = _read_cell(folder, cell)
        if found is not None:
            rows[cell] = found
    missing = [cell for cell in cells if cell not in rows]
    with progress_bar("sweep-alpha", len(cells)) as advance:
        advance(len(rows), "")
        try:
            results = ordered_map(_run_cell, missing, options.workers, ahead=1)
            for cell, found in zip(missing, results, strict=True):
                rows[cell] = found
                value = {"cell": _cell_key(cell), "rows": found}
                write_json(folder / _cell_name(cell), value)
                advance(1, f"{cell.task} {cell.form} alpha {cell.pd.alpha:g}")
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted with {len(rows)} of {len(cells)} settings done; "
                "--resume goes on from there"
            ) from None
    kept = [row for cell in sweep for row in rows[cell] if row["task"] in options.tasks]
    smooth = [row for cell in worth for row in rows[cell] if row["task"] == SMOOTH]
    return [*kept, *smooth], [row for cell in carried for row in rows[cell]]


def _run_cell(cell: SweepCell) -> list[Row]:
    return run_cell(cell) if cell.mass is None else run_load_cell(cell)


def _cells(options: SweepAlpha) -> list[SweepCell]:
    alphas = np.linspace(0, 1, options.alphas).round(6).tolist()
    return [
        SweepCell(task, form, PdConfig(alpha=alpha), options.goals, options.seed)
        for task, served in RUNS.items()
        if set(served) & set(options.tasks)
        for form in options.forms
        for alpha in alphas
    ]


def _worth_cells(options: SweepAlpha) -> list[SweepCell]:
    if not options.worth_goals or SMOOTH not in options.tasks:
        return []
    alphas = np.arange(0, 1 + FINE / 2, FINE).round(6).tolist()
    policies = [*(PdConfig(alpha=alpha) for alpha in alphas), *RULES]
    goals, seed = options.worth_goals, options.seed + 1
    return [
        SweepCell("Reach-v0", "blend", pd, goals, seed, SHORT_EPISODE)
        for pd in policies
    ]


def _cells_folder(out: Path) -> Path:
    out = out.absolute()
    return out.with_name(f".{out.name}.cells")


def _cell_name(cell: SweepCell) -> str:
    pd = cell.pd
    parts = [cell.task, cell.form, pd.alpha_rule, f"{pd.alpha:g}", str(cell.seed)]
    parts += [] if cell.mass is None else [f"{cell.mass:g}-kg"]
    return "-".join(parts) + ".json"


def _cell_key(cell: SweepCell) -> dict[str, Any]:
    """All that the rows depend on: settings, config, sources of the controller."""
    config = config_dict(make_task(cell.task, cell.overrides))
    sources = source_fingerprint()
    return {**cell.to_json(), "config": config, "sources": sources, **versions()}


def _read_cell(folder: Path, cell: SweepCell) -> list[Row] | None:
    """A finished setting's rows, if they are there and of this very setting."""
    try:
        value = json.loads((folder / _cell_name(cell)).read_text())
    except (OSError, ValueError):
        return None
    if value.get("cell") != json.loads(json.dumps(_cell_key(cell))):
        return None
    rows: list[Row] = value["rows"]
    return rows


def _described(options: SweepAlpha) -> dict[str, Any]:
    described = {**asdict(options), "out": options.out.name}
    for name in ("resume", "overwrite", "json", "workers", "check"):
        del described[name]
    return {"options": described, "versions": versions()}
