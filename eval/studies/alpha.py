"""The learnt alpha over time, and its worth.

Worth: the return of a trained agent against the same agent with its alpha held at one
value, on the same goals.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product, starmap
from pathlib import Path
from typing import Any, cast

import numpy as np

from marl_mm.algorithms.checkpoint import BEST
from marl_mm.algorithms.policy import load_policy
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.episode import Episode
from marl_mm.eval.goals import goal_set
from marl_mm.eval.grouping import by_goal, engine_in, grouped, mean_of
from marl_mm.eval.intervals import bootstrap_interval
from marl_mm.eval.metrics import Row, alphas
from marl_mm.eval.rows import read_rows, write_csv
from marl_mm.eval.studies.cells import run_cells
from marl_mm.eval.studies.held import FixedAlpha
from marl_mm.eval.studies.online import STUDIES
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.tables import markdown_table
from marl_mm.policy import Policy
from marl_mm.progress import Bar
from marl_mm.runs.evaluate import task_overrides
from marl_mm.runs.folder import read_config
from marl_mm.sim.config import Engine
from marl_mm.versions import engine_text

ABOUT = "What alpha the trained agents choose, and what it is worth."
"""Title."""

ALPHAS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.8, 0.9, 1.0)
"""Fixed alphas, closer where the best one lies on ``SmoothReach-v0``."""

LEARNT = "learnt"

CHOOSING = STUDIES["online"].part(
    None, ("ddpg-her", "ddpg-her-smooth", "maddpg-her-smooth")
)
"""Agents whose alpha is compared."""

LABELS = {setting.name: setting.about for _, setting in CHOOSING.cells}

GOALS, STEPS, WORTH = "alpha_goals.csv.xz", "alpha_steps.csv", "alpha_worth.csv"
"""Files of the rows, of alpha over time, and of the table."""


@dataclass(frozen=True)
class WorthCell:
    """A trained run, its alpha learnt or held."""

    setting: str
    """Name of the setting."""

    seed: int
    """Seed of the run."""

    weights: str
    """Fingerprint of the best checkpoint."""

    task: str
    """Registered name of the task."""

    engine: Engine
    """Engine of the run."""

    max_steps: int | None
    """Steps of an episode; None: the task's."""

    goals: int
    """Number of goals."""

    alpha: float | None
    """Alpha that is held; None: the learnt one."""

    @property
    def overrides(self) -> dict[str, Any]:
        """Settings of the task that are replaced."""
        return task_overrides(self.max_steps, self.engine)

    @property
    def label(self) -> str:
        """Label in the progress bar."""
        return f"{self.setting} {self.seed}, alpha {self.acting}"

    @property
    def acting(self) -> float | str:
        """Alpha in the rows."""
        return LEARNT if self.alpha is None else self.alpha


def make_worth(options: StudyOptions, bar: Bar) -> list[Row]:
    """Run the agents of ``CHOOSING`` with the learnt alpha and with held ones.

    Returns:
        Rows of the table.

    Raises:
        KeyboardInterrupt: After Ctrl-C; what is finished is kept.
    """
    chosen = product(CHOOSING.cells, options.seeds_of(CHOOSING))
    runs = {
        cell: run.absolute()
        for run in starmap(options.run_folder, chosen)
        for cell in _cells(options, run)
    }
    run, kept = partial(run_cell, runs), options.runs_folder / "alpha"
    progress = bar, "alpha"
    rows = run_cells(run, [*runs], kept, options.workers, progress, options.executor)
    both = [row for cell in runs for row in rows[cell]]
    write_csv(options.results / GOALS, [row for row in both if "goal" in row])
    write_csv(options.results / STEPS, [row for row in both if "goal" not in row])
    return draw_worth(options.results, options.results)


def _cells(options: StudyOptions, run: Path) -> list[WorthCell]:
    made_of = read_config(run)
    goals, alphas = (2, ALPHAS[::6]) if options.small else (100, ALPHAS)
    cell = WorthCell(
        run.parent.name,
        made_of.seed,
        load_policy(run / BEST).fingerprint,
        made_of.task,
        cast(Engine, made_of.engine),
        made_of.settings.get("max_steps"),
        goals,
        None,
    )
    return [cell, *(replace(cell, alpha=alpha) for alpha in alphas)]


def run_cell(runs: Mapping[WorthCell, Path], cell: WorthCell) -> list[Row]:
    """A row per goal; of the learnt alpha also one per direction and step."""
    task = make_task(cell.task, cell.overrides)
    policy: Policy = load_policy(runs[cell] / BEST)
    if cell.alpha is not None:
        policy = FixedAlpha(policy, cell.alpha)
    head: Row = {"setting": cell.setting, "seed": cell.seed, "task": cell.task}
    head["engine"] = engine_text(cell.engine)
    # Goals of seeds 0 and 1 are the runs' own evaluations.
    plans = goal_set(task, cell.goals, seed=2)
    with Rollouts(task) as rollouts:
        episodes = [*rollouts.run(policy, plans)]
    goals = [_goal(cell.acting, episode) for episode in episodes]
    steps = _steps(episodes) if cell.alpha is None else ()
    return [head | row for row in (*goals, *steps)]


def _goal(alpha: float | str, episode: Episode) -> Row:
    return {
        "alpha": alpha,
        "goal": episode.index,
        "direction": episode.direction,
        "success": int(episode.success),
        "steps": len(episode),
        "return": episode.episode_return,
    }


def _steps(episodes: Sequence[Episode]) -> Iterator[Row]:
    """Alpha at each step of the episodes that come to it, by direction."""
    for direction in ("forward", "backward"):
        lines = [alphas(e) for e in episodes if e.direction == direction]
        for step in range(max(map(len, lines), default=0)):
            values = [line[step] for line in lines if len(line) > step]
            yield {
                "direction": direction,
                "step": step + 1,
                "episodes": len(values),
                "mean": float(np.mean(values)),
                "std": float(np.std(values)),
            }


def draw_worth(results: Path, folder: Path) -> list[Row]:
    """Write table and figure of the learnt alpha's worth into a folder, from its rows.

    Returns:
        Rows of the table.
    """
    from marl_mm.eval.studies.figures import alpha_figure  # imports matplotlib

    summary = summarize_worth(read_rows(results / GOALS))
    write_csv(folder / WORTH, summary)
    alpha_figure(read_rows(results / STEPS), summary, LABELS, folder / "alpha.png")
    return summary


def summarize_worth(rows: Sequence[Row]) -> list[Row]:
    """One row per setting, seed and fixed alpha: how much better the learnt one is.

    The difference is paired, goal by goal; its interval is by bootstrap over goals.
    """
    summary = []
    for (setting, seed), group in grouped(rows, "setting", "seed").items():
        by_alpha = grouped(group, "alpha")
        learnt = by_goal(by_alpha.pop(LEARNT), "return")
        for alpha, held in by_alpha.items():
            difference = learnt - by_goal(held, "return")
            summary.append(
                {
                    "setting": setting,
                    "task": held[0]["task"],
                    **engine_in(held),
                    "seed": seed,
                    "alpha": alpha,
                    "goals": len(held),
                    "success": mean_of(held, "success"),
                    "return": mean_of(held, "return"),
                    "learnt_return": float(learnt.mean()),
                    "difference": float(difference.mean()),
                    "difference_interval": bootstrap_interval(difference),
                    "better_on": int((difference > 0).sum()),
                }
            )
    return summary


def worth_table(summary: Sequence[Row]) -> str:
    """The learnt alpha against the best one held, an agent a row, as Markdown."""
    lines = []
    for group in grouped(summary, "setting", "seed").values():
        best = max(group, key=lambda row: float(row["return"]))
        low, high = best["difference_interval"]
        lines.append(
            (
                LABELS[best["setting"]],
                best["task"],
                str(best["seed"]),
                str(best["goals"]),
                f"{best['learnt_return']:.2f}",
                f"{best['alpha']:g}",
                f"{best['return']:.2f}",
                f"{best['difference']:.2f} [{low:.2f}, {high:.2f}]",
                f"{best['better_on']}/{best['goals']}",
            )
        )
    header = (
        *("agent", "task", "seed", "goals", "return, alpha learnt", "best alpha held"),
        *("its return", "difference [95 % interval]", "better on"),
    )
    return markdown_table(header, lines)
