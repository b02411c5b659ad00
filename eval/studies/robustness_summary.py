"""Tables of teams against joint actors under disturbances, drawn from their rows."""

from collections.abc import Sequence
from itertools import chain, product
from pathlib import Path

import numpy as np

from marl_mm.eval.grouping import by_goal, grouped, mean_of
from marl_mm.eval.intervals import interval_of_gain
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies.cells import read_cells
from marl_mm.eval.tables import markdown_table, points_with_interval
from marl_mm.runs.recipes import RECIPES

TABLE = "robustness.csv"
"""File of the table, a row per dataset, algorithm and disturbance."""

CROSS_PLAY = "robustness_cross_play.csv"
"""File of the table of agents of other runs, a row per dataset, algorithm, agent that
is replaced, and algorithm that the other agent is of."""

FORMS = (
    *(("bc", "mabc"), ("flow-bc", "ma-flow-bc"), ("iql", "ma-iql")),
    *(("rebrac", "ma-rebrac"), ("td3-bc", "matd3-bc"), ("cql", "cfcql")),
    *(("fql", "mac-flow"), ("best-of-n-joint", "best-of-n")),
)
"""Algorithms: the form with a joint actor, and the team's."""

PREFIX = "robust-"
"""Beginning of the settings' names, before the algorithm's."""

SETTINGS = [[f"{PREFIX}{name}" for name in form] for form in zip(*FORMS, strict=True)]
"""Names of the settings with joint actors, and of those with teams."""

SOURCES = {
    RECIPES.get(name).source.name: name for name in ("gate-expert", "bar-expert")
}
"""Recipes of the datasets that are learnt from, by the datasets' names."""

FEW = 0.3
"""Success rate below which a form has few goals to lose."""

CLEAN, ALL = "clean", "all"
"""Names of the run without a disturbance, and of the mean over disturbances."""

OTHER_SEED, OTHER_ALGORITHM = "other seed", "other algorithm"
"""Names of disturbances: an agent is one of another run. They are not in the mean: by
them joint actors meet joint actors, and teams meet teams."""


def rows_folder(results: Path) -> Path:
    """Folder of the rows, among results."""
    return results / "rows" / "robustness"


def draw_robustness(results: Path, folder: Path) -> list[Row]:
    """Write both tables into a folder, from rows in another.

    Returns:
        Rows of the table of disturbances.

    Raises:
        UsageError: If there are no rows.
    """
    read = read_cells(rows_folder(results)).values()
    cells = grouped([row for rows in read for row in rows], "dataset", "setting")
    summary: list[Row] = []
    for dataset, form in product(SOURCES, FORMS):
        pair = [cells.get((dataset, f"{PREFIX}{name}"), []) for name in form]
        if all(pair):
            summary += _compared({"dataset": dataset, "joint": form[0]}, *pair)
    write_csv(folder / TABLE, summary)
    crossed = [
        row
        for dataset, name in product(SOURCES, chain(*zip(*FORMS, strict=True)))
        if (rows := cells.get((dataset, f"{PREFIX}{name}")))
        for row in _crossed(dataset, name, rows)
    ]
    write_csv(folder / CROSS_PLAY, crossed)
    return summary


def _crossed(dataset: str, name: str, rows: Sequence[Row]) -> list[Row]:
    """A row per agent that is replaced, and algorithm that the other agent is of."""
    own = [row | {"strength": name} for row in rows if row["disturbance"] == OTHER_SEED]
    others = [row for row in rows if row["disturbance"] == OTHER_ALGORITHM]
    crossed = []
    clean = _successes(rows)
    for (agent, partner), some in grouped([*own, *others], "agent", "strength").items():
        change = _mean_change(some, clean)
        crossed.append(
            {
                "dataset": dataset,
                "engine": some[0]["engine"],
                "algorithm": name,
                "agent": agent,
                "from": partner,
                "seeds": len(change),
                "goals": change.shape[1],
                "success": mean_of(some, "success"),
                "difference": float(change.mean()),
                "difference_interval": interval_of_gain(change),
            }
        )
    return crossed


def _compared(head: Row, joint: Sequence[Row], team: Sequence[Row]) -> list[Row]:
    """A row per disturbance that both have met, and one of their mean."""
    met = [dict.fromkeys(row["disturbance"] for row in form) for form in (joint, team)]
    names = [name for name in met[0] if name in met[1] and name != CLEAN]
    of_joint, of_team = _changes(joint, names), _changes(team, names)
    joint_clean, team_clean = _successes(joint), _successes(team)
    rows = []
    for name in of_joint:
        more = of_team[name] - of_joint[name]
        ahead = more + (team_clean - joint_clean)
        rows.append(
            {
                **head,
                "engine": joint[0]["engine"],
                "disturbance": name,
                "seeds": len(more),
                "goals": more.shape[1],
                "joint_clean": float(joint_clean.mean()),
                "joint_change": float(of_joint[name].mean()),
                "team_clean": float(team_clean.mean()),
                "team_change": float(of_team[name].mean()),
                "keeps_more": float(more.mean()),
                "keeps_more_interval": interval_of_gain(more),
                "ahead": float(ahead.mean()),
                "ahead_interval": interval_of_gain(ahead),
            }
        )
    return rows


def _successes(rows: Sequence[Row]) -> np.ndarray:
    """Success without a disturbance, shape (seeds, goals)."""
    seeds = len(grouped(rows, "seed"))
    clean = by_goal(grouped(rows, "disturbance")[CLEAN], "success")
    return clean.reshape(seeds, -1)


def _changes(rows: Sequence[Row], names: Sequence[str]) -> dict[str, np.ndarray]:
    """Success less that of the clean run, by disturbance, shapes (seeds, goals).

    It is the mean over agents and strengths; ``ALL`` is the mean over disturbances.
    """
    of, clean = grouped(rows, "disturbance"), _successes(rows)
    changes = {name: _mean_change(of[name], clean) for name in names}
    same = [changes[n] for n in names if n not in (OTHER_SEED, OTHER_ALGORITHM)]
    return {**changes, ALL: np.mean(same, axis=0)}


def _mean_change(some: Sequence[Row], clean: np.ndarray) -> np.ndarray:
    """Mean success of some rows less the clean one, by seed and goal."""
    means = [
        mean_of(of_goal, "success")
        for _, of_goal in sorted(grouped(some, "seed", "goal").items())
    ]
    change: np.ndarray = np.array(means).reshape(clean.shape) - clean
    return change


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


def cross_play_table(crossed: Sequence[Row]) -> str:
    """What teams reach with an agent of another algorithm, as Markdown.

    The agent that is replaced is the first one; the table has rows of all.
    """
    tables, teams = [], [team for _, team in FORMS]
    for dataset, rows in grouped(crossed, "dataset").items():
        agent = rows[0]["agent"]
        cells = {
            (row["algorithm"], row["from"]): _crossed_text(row)
            for row in rows
            if row["agent"] == agent and row["algorithm"] in teams
        }
        names = [name for name in teams if any(name in pair for pair in cells)]
        lines = [
            [f"`{own}`", *(cells.get((own, other), "") for other in names)]
            for own in names
            if any(own == team for team, _ in cells)
        ]
        heads = [f"`{SOURCES[dataset]}`, team of", *(f"from `{n}`" for n in names)]
        engine = f"Agent `{agent}` of another run, engine {rows[0]['engine']}."
        tables.append(f"{engine}\n\n{markdown_table(heads, lines)}")
    return "\n".join(tables)


def _crossed_text(row: Row) -> str:
    """Success, and its change, bold where the interval excludes 0."""
    low, high = row["difference_interval"]
    change = f"{100 * row['difference']:+.1f}"
    change = change if low <= 0 <= high else f"**{change}**"
    return f"{100 * row['success']:.1f}, {change}"


def _points(row: Row | None, name: str) -> str:
    """A difference in points, in brackets where a form has few goals to lose."""
    if row is None:
        return ""
    text = points_with_interval(row[name], row[f"{name}_interval"])
    few = min(row["joint_clean"], row["team_clean"]) < FEW
    return f"({text})" if few else text
