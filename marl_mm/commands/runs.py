"""marl-mm runs: the runs below a folder, with their scores."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from marl_mm.commands.parser import parse_options
from marl_mm.errors import CheckpointError
from marl_mm.runs.run import Run, find_runs


@dataclass(frozen=True)
class Runs:
    """List runs with what they learnt from, how far they are, and their scores."""

    folder: tyro.conf.Positional[Path] = Path("runs")
    """Folder with runs in it, at any depth."""

    json: bool = False
    """Print JSON."""


def main(arguments: Sequence[str]) -> None:
    """Run the command line of ``marl-mm runs``."""
    options = parse_options(Runs, "marl-mm runs", arguments)
    rows = [_row(run, options.folder) for run in find_runs(options.folder)]
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    if not rows:
        print(f"no runs below {options.folder}: marl-mm train makes them")
        return
    columns = [name for name in rows[0] if any(row[name] is not None for row in rows)]
    table = Table(*columns, title=f"below {options.folder}")
    for row in rows:
        table.add_row(*(escape(_text(row[name])) for name in columns))
    console = Console()
    if not console.is_terminal:  # whole names, for a search
        console = Console(width=200)
    console.print(table)


def _row(run: Run, folder: Path) -> dict[str, Any]:
    name = str(run.folder.relative_to(folder))
    try:
        config, metrics, evaluation = run.config, run.metrics, run.evaluation
    except CheckpointError as error:
        return _cells(name, note=str(error))
    clock = "updates" if "updates" in config.settings else "episodes"
    last = metrics[-1] if metrics else {}
    dataset = config.dataset["id"] if config.dataset else None
    done = last.get("step", last.get("episode", 0))
    scores: dict[str, Any] = {}
    if evaluation is not None:
        everything = evaluation.summary["all"]
        low, high = everything["interval"]
        scores = {
            "success [%]": round(100 * evaluation.success_rate, 1),
            "95 % interval": [round(100 * low, 1), round(100 * high, 1)],
            "return": round(everything["return"], 2),
        }
    return _cells(
        name,
        algorithm=config.algorithm,
        task=config.task,
        dataset=dataset,
        trained=f"{done} of {config.settings.get(clock, '?')} {clock}",
        **scores,
    )


def _cells(name: str, **values: Any) -> dict[str, Any]:
    columns = ("algorithm", "task", "dataset", "trained")
    scores = ("success [%]", "95 % interval", "return", "note")
    return {"run": name, **{key: values.get(key) for key in (*columns, *scores)}}


def _text(value: Any) -> str:
    if isinstance(value, list):
        return f"[{value[0]}, {value[1]}]"
    return "-" if value is None else str(value)
