"""Table of teams against joint actors under disturbances, drawn from their rows."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np

from marl_mm.eval.grouping import by_goal, grouped
from marl_mm.eval.intervals import interval_of_mean
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies.cells import read_cells
from marl_mm.eval.tables import markdown_table
from marl_mm.runs.recipes import RECIPES

TABLE = "robustness.csv"
"""File of the table, a row per dataset, algorithm and disturbance."""

FORMS = (
    *(("bc", "mabc"), ("flow-bc", "ma-flow-bc"), ("iql", "ma-iql")),
    *(("rebrac", "ma-rebrac"), ("td3-bc", "matd3-bc"), ("cql", "cfcql")),
    *(("fql", "mac-flow"), ("best-of-n-joint", "best-of-n")),
)
"""Algorithms: the form with a joint actor, and the team's."""

SOURCES = {
    RECIPES.get(name).source.name: name for name in ("quiet-zone-expert", "gate-expert")
}
"""Recipes of the datasets that are learnt from, by the datasets' names."""

FEW = 0.3
"""Success rate below which a form has few goals to lose."""

CLEAN, ALL = "clean", "all"
"""Names of the run without a disturbance, and of the mean over disturbances."""


def rows_folder(results: Path) -> Path:
    """Folder of the rows, among results."""
    return results / "rows" / "robustness"


def draw_robustness(results: Path, folder: Path) -> list[Row]:
    """Write the table into a folder, from rows in another.

    Returns:
        Rows of the table.

    Raises:
        UsageError: If there are no rows.
    """
    read = read_cells(rows_folder(results)).values()
    cells = grouped([row for rows in read for row in rows], "dataset", "setting")
    summary: list[Row] = []
    for dataset, form in product(SOURCES, FORMS):
        pair = [cells.get((dataset, f"robust-{name}"), []) for name in form]
        if all(pair):
            summary += _compared({"dataset": dataset, "joint": form[0]}, *pair)
    write_csv(folder / TABLE, summary)
    return summary


def _compared(head: Row, joint: Sequence[Row], team: Sequence[Row]) -> list[Row]:
    """A row per disturbance, and one of their mean."""
    of_joint, of_team = _changes(joint), _changes(team)
    clean = _successes(team) - _successes(joint)
    rows = []
    for name in of_joint:
        more = of_team[name] - of_joint[name]
        ahead = more + clean
        rows.append(
            {
                **head,
                "engine": joint[0]["engine"],
                "disturbance": name,
                "seeds": len(more),
                "goals": more.shape[1],
                "joint_clean": float(_successes(joint).mean()),
                "joint_change": float(of_joint[name].mean()),
                "team_clean": float(_successes(team).mean()),
                "team_change": float(of_team[name].mean()),
                "keeps_more": float(more.mean()),
                "keeps_more_interval": interval_of_mean(more),
                "ahead": float(ahead.mean()),
                "ahead_interval": interval_of_mean(ahead),
            }
        )
    return rows


def _successes(rows: Sequence[Row]) -> np.ndarray:
    """Success without a disturbance, shape (seeds, goals)."""
    seeds = len(grouped(rows, "seed"))
    clean = by_goal(grouped(rows, "disturbance")[CLEAN], "success")
    return clean.reshape(seeds, -1)


def _changes(rows: Sequence[Row]) -> dict[str, np.ndarray]:
    """Success less that of the clean run, by disturbance, shapes (seeds, goals).

    It is the mean over agents and strengths; ``ALL`` is the mean over disturbances.
    """
    clean, changes = _successes(rows), {}
    for name, some in grouped(rows, "disturbance").items():
        if name != CLEAN:
            every = grouped(some, "agent", "strength").values()
            mean = np.mean([by_goal(rows, "success") for rows in every], axis=0)
            changes[name] = mean.reshape(clean.shape) - clean
    return {**changes, ALL: np.mean([*changes.values()], axis=0)}


def robustness_table(summary: Sequence[Row]) -> str:
    """What teams keep more than joint actors, a line per algorithm, as Markdown."""
    names = list(dict.fromkeys(row["disturbance"] for row in summary))
    lines = []
    for (dataset, joint), rows in grouped(summary, "dataset", "joint").items():
        by_name = {row["disturbance"]: row for row in rows}
        reached = [
            f"{100 * by_name[ALL][f'{form}_clean']:.1f}, "
            f"{100 * by_name[ALL][f'{form}_change']:+.1f}"
            for form in ("joint", "team")
        ]
        about = f"`{SOURCES[dataset]}`", f"`{joint}`, `{dict(FORMS)[joint]}`"
        ahead = _points(by_name[ALL], "ahead")
        more = (_points(by_name.get(name), "keeps_more") for name in names)
        lines.append([*about, *reached, ahead, *more])
    heads = ["dataset", "joint actor, team", "joint actor [%]", "team [%]"]
    heads += ["team ahead, disturbed"]
    table = markdown_table([*heads, *names], lines)
    engines = ", ".join(sorted({row["engine"] for row in summary}))
    return f"Engine {engines}.\n\n{table}"


def _points(row: Row | None, name: str) -> str:
    """A difference in points, in brackets where a form has few goals to lose."""
    if row is None:
        return ""
    values = (row[name], *row[f"{name}_interval"])
    mean, low, high = (f"{100 * value:+.1f}" for value in values)
    few = min(row["joint_clean"], row["team_clean"]) < FEW
    return f"({mean} [{low}, {high}])" if few else f"{mean} [{low}, {high}]"
