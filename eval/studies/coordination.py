"""What a team's agents are worth to each other: experts, and teams that lack something.

Every team is the task's expert with a change: alpha held, an agent at random, late or
blind, robots of different conventions. Levels of a task are compared by noisy experts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.envs.registry import fewest_steps, make_task
from marl_mm.errors import UsageError
from marl_mm.eval.evaluate import check_task
from marl_mm.eval.grouping import by_goal, grouped, mean_of
from marl_mm.eval.intervals import paired_interval, success_interval
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies.cells import missing_groups, read_cells, run_cells
from marl_mm.eval.studies.options import PolicyOptions
from marl_mm.eval.studies.policies import Contestant, PolicyCell, run_cell
from marl_mm.eval.tables import markdown_table, rate_in_interval
from marl_mm.progress import Bar
from marl_mm.sim.config import Engine

ABOUT = "Teams that lack something, beside their experts: what coordination is worth."
"""Title."""

TABLE, WORTH = "coordination.csv", "coordination_worth.csv"
"""Files of the tables: a row per task and team, and a row per task."""

KINDS = ("QuietZone", "Gate", "Tray", "MovingReach", "Bar", "Course")
"""Tasks in which the team decides, without their level."""

LEVELS = ("-easy", "", "-hard")
"""Parts of the levels' names, in their order."""

ALPHAS = tuple(round(0.1 * i, 1) for i in range(11))
"""Alphas that are held."""

NOISES = (0.05, 0.1, 0.2, 0.3)
"""Noises of the experts by which levels are compared, in halves of actions' ranges."""

EXPERT = "expert"
"""Name of the team that lacks nothing."""


@dataclass(frozen=True, kw_only=True)
class CoordinationOptions(PolicyOptions):
    """Settings of the comparison of teams."""

    tasks: tuple[str, ...] = tuple(f"{kind}-v0" for kind in KINDS)
    """Registered names of the tasks."""

    engine: Engine | None = None
    """Engine of the simulation, bullet or mujoco; default mujoco."""

    def check_settings(self) -> None:
        """Raise for options that make no sense.

        Raises:
            UsageError: Naming the option.
        """
        super().check_settings()
        if self.seeds is not None:
            raise UsageError("`seeds` are of trained runs: teams have none")

    @property
    def cells_folder(self) -> Path:
        """Folder of the teams' rows."""
        return self.runs_folder / "coordination"


def teams(name: str) -> list[Contestant]:
    """Teams of a task."""
    task = make_task(name)
    agents = [agent.name for agent in task.layout.team]
    knowing = [
        agent.name for agent in task.layout.team if set(task.hidden) & set(agent.sees)
    ]
    balances = [agent for agent in agents if agent.endswith("balance")]
    listed = [_team(EXPERT)]
    listed += [_team(f"alpha {alpha:g}", held_alpha=alpha) for alpha in ALPHAS]
    listed += [_team(f"random {agent}", random_agents=(agent,)) for agent in agents]
    listed += [_team(f"late {agent}", late_agents=(agent,)) for agent in balances]
    listed += [_team(f"blind {agent}", blind_agents=(agent,)) for agent in knowing]
    if task.robots > 1:
        listed += [
            _team(" and ".join(words), conventions=words)
            for words in product(task.conventions, repeat=task.robots)
        ]
    return listed


def _team(name: str, **settings: Any) -> Contestant:
    return Contestant(name, "varied", tuple(settings.items()))


def cells_of(options: CoordinationOptions) -> dict[str, list[PolicyCell]]:
    """Cells of every task: its teams, and noisy experts of it and its other levels."""
    engine = options.engine or "mujoco"
    goals = 2 if options.small else options.goals
    noisy = [_team(f"noise {noise:g}", noise=noise) for noise in NOISES]
    cells = {}
    for task in options.tasks:
        listed = teams(task)
        cells[task] = [*(listed[::4] if options.small else listed), *noisy]
        kind = task.removesuffix("-v0")
        if kind in KINDS:
            levels = (f"{kind}{level}-v0" for level in LEVELS if level)
            cells |= {name: noisy for name in levels if name not in options.tasks}
    return {
        task: [
            PolicyCell(
                *(task, engine, contestant, goals),
                fewest_steps(task, 4) if options.small else None,
            )
            for contestant in contestants
        ]
        for task, contestants in cells.items()
    }


def make_coordination(options: CoordinationOptions, bar: Bar) -> list[Row]:
    """Run the teams that are missing, and draw the tables.

    Returns:
        Rows of the table of teams.

    Raises:
        UsageError: If an option makes no sense, or an engine lacks a task.
        KeyboardInterrupt: After Ctrl-C; finished teams are kept.
    """
    options.check_settings()
    cells = cells_of(options)
    for task, (first, *_) in cells.items():
        check_task(make_task(task, first.overrides))
    groups = missing_groups(groups_of(options), options.overwrite)
    every = [cell for listed in groups.values() for cell in listed]
    pool = options.workers, (bar, "coordination"), options.executor
    run_cells(run_cell, every, options.cells_folder, *pool, groups)
    return draw_coordination(options.results, options.results)


def groups_of(options: CoordinationOptions) -> dict[Path, list[PolicyCell]]:
    """Cells by the path of their task's rows, see ``write_cells``."""
    folder = _rows_folder(options.results)
    return {folder / task: cells for task, cells in cells_of(options).items()}


def _rows_folder(results: Path) -> Path:
    return results / "rows" / "coordination"


def draw_coordination(results: Path, folder: Path) -> list[Row]:
    """Write the tables into a folder, from rows in another.

    Returns:
        Rows of the table of teams.

    Raises:
        UsageError: If there are no rows.
    """
    tables = read_cells(_rows_folder(results))
    summary = [row for task, rows in tables.items() for row in _reached(task, rows)]
    write_csv(folder / TABLE, summary)
    of_teams = {
        task: rows
        for task, rows in tables.items()
        if any(row["policy"] == EXPERT for row in rows)
    }
    write_csv(folder / WORTH, [_worth(*item) for item in of_teams.items()])
    return summary


def _reached(task: str, rows: Sequence[Row]) -> list[Row]:
    """A row per team: goals reached, and the steps that took."""
    summary = []
    for team, group in grouped(rows, "policy").items():
        reached = [row for row in group if row["success"]]
        summary.append(
            {
                "task": task,
                "team": team,
                "engine": group[0]["engine"],
                "goals": len(group),
                "success": mean_of(group, "success"),
                "interval": success_interval(len(reached), len(group)),
                "steps": mean_of(reached, "steps") if reached else np.nan,
            }
        )
    return summary


def _worth(task: str, rows: Sequence[Row]) -> Row:
    """The expert less the best of the teams that hold an alpha, goal by goal."""
    groups = grouped(rows, "policy")
    rates = {team: mean_of(group, "success") for team, group in groups.items()}
    constant = [team for team in rates if team.startswith("alpha ")]
    best = max(constant, key=lambda team: rates[team])
    expert, other = (by_goal(groups[team], "success") for team in (EXPERT, best))
    partner = max(rates[team] for team in rates if team.startswith("random "))
    return {
        "task": task,
        "engine": rows[0]["engine"],
        "goals": len(expert),
        "expert": rates[EXPERT],
        "best_constant": best,
        "constant": rates[best],
        "difference": float((expert - other).mean()),
        "difference_interval": paired_interval(expert, other),
        "random_partner": partner,
    }


# --- Tables ------------------------------------------------------------------


def coordination_table(summary: Sequence[Row]) -> str:
    """Goals reached by every team, a column per task, as Markdown."""
    by_task = {
        task: {row["team"]: row for row in group}
        for task, group in grouped(summary, "task").items()
    }
    engines = sorted({row["engine"] for row in summary})
    shown = {task: rows for task, rows in by_task.items() if EXPERT in rows}
    words = dict.fromkeys(team for rows in shown.values() for team in rows)
    lines = [
        [team, *(_rate(rows.get(team)) for rows in shown.values())] for team in words
    ]
    table = markdown_table(["team", *shown], lines)
    return f"Goals reached [%], engine {', '.join(engines)}.\n\n{table}"


def levels_table(summary: Sequence[Row]) -> str:
    """Goals that noisy experts reach on every level, as Markdown."""
    rates = {(row["task"], row["team"]): row for row in summary}
    kinds = [kind for kind in KINDS if (f"{kind}-easy-v0", "noise 0.1") in rates]
    lines = []
    for kind, noise in product(kinds, NOISES):
        names = (f"{kind}{level}-v0" for level in LEVELS)
        cells = (_rate(rates.get((name, f"noise {noise:g}"))) for name in names)
        lines.append([kind, f"{noise:g}", *cells])
    return markdown_table(["task", "noise", "easy", "medium", "hard"], lines)


def worth_table(rows: Sequence[Row]) -> str:
    """What a state-dependent alpha is worth, a row per task, as Markdown."""
    header = ["task", "expert [%]", "best constant alpha [%]", "difference [95 %]"]
    lines = []
    for row in rows:
        low, high = row["difference_interval"]
        lines.append(
            [
                row["task"],
                f"{100 * row['expert']:.1f}",
                f"{100 * row['constant']:.1f} ({row['best_constant'].split()[-1]})",
                f"{100 * row['difference']:.1f} [{100 * low:.1f}, {100 * high:.1f}]",
                f"{100 * row['random_partner']:.1f}",
            ]
        )
    return markdown_table([*header, "with a random partner, at most [%]"], lines)


def _rate(row: Row | None) -> str:
    if row is None:
        return ""
    return rate_in_interval(row["success"], row["interval"])
