"""marl-mm runs: the runs below a folder, with their scores."""

from pathlib import Path
from typing import Any

import tyro

from marl_mm.commands.output import print_rows
from marl_mm.commands.parser import command
from marl_mm.errors import CheckpointError, MarlMmError
from marl_mm.received import damage_named
from marl_mm.runs.run import Run, find_runs

_COLUMNS = ("algorithm", "task", "engine", "dataset", "trained")
_SCORES = ("success [%]", "95 % interval", "return", "note")


@command
def main(
    folder: tyro.conf.Positional[Path] = Path("runs"), *, json: bool = False
) -> None:
    """List runs with what they learnt from, how far they are, and their scores.

    Args:
        folder: Folder with runs in it, at any depth.
        json: Print JSON.
    """
    runs = {str(run.folder.relative_to(folder)): run for run in find_runs(folder)}
    cells = {name: _cells(run) for name, run in runs.items()}
    rows = [
        {"run": name, **{key: row.get(key) for key in (*_COLUMNS, *_SCORES)}}
        for name, row in cells.items()
    ]
    if rows or json:
        print_rows(rows, json, f"below {folder}")
    else:
        print(f"no runs below {folder}: marl-mm train makes them")


def _cells(run: Run) -> dict[str, Any]:
    """A run's values, by column; of a damaged run only a note with the reason."""
    try:
        with damage_named(str(run.folder), CheckpointError):
            return _read(run)
    except (MarlMmError, OSError) as error:
        return {"note": str(error)}


def _read(run: Run) -> dict[str, Any]:
    config, metrics, evaluation = run.config, run.metrics, run.evaluation
    clock = "updates" if "updates" in config.settings else "episodes"
    last = metrics[-1] if metrics else {}
    done = last.get("step", last.get("episode", 0))
    trained = f"{done} of {config.settings.get(clock, '?')} {clock}"
    if asked := config.settings.get("online_steps"):
        trained = f"{done} updates, {last.get('env_steps', 0)} of {asked} own steps"
    cells = {
        "algorithm": config.algorithm,
        "task": config.task,
        "engine": config.engine,
        "dataset": config.dataset["id"] if config.dataset else None,
        "trained": trained,
    }
    if evaluation is None:
        return cells
    everything = evaluation.summary["all"]
    return cells | {
        "success [%]": round(100 * evaluation.success_rate, 1),
        "95 % interval": [round(100 * bound, 1) for bound in everything["interval"]],
        "return": round(everything["return"], 2),
    }
