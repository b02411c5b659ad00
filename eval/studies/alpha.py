"""The learnt alpha: what it is over time, and what it is worth.

Worth: the return of a trained agent against the same agent with its alpha held at one
value, on the same goals.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.episode import Episode
from marl_mm.eval.goals import goal_set
from marl_mm.eval.intervals import bootstrap_interval
from marl_mm.eval.metrics import Row, alphas
from marl_mm.eval.tables import markdown_table
from marl_mm.layout import Layout
from marl_mm.policy import Policy
from marl_mm.progress import Advance, silent

ALPHAS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.8, 0.9, 1.0)
"""Alphas that are held, closer where the best one lies on ``SmoothReach-v0``."""

LEARNT = "learnt"


class FixedAlpha:
    """A policy whose alpha is held, and which does not notice.

    Where the state has the last alpha, the policy sees the one that it chose itself: a
    joint actor would otherwise move the hand differently, too.

    Args:
        policy: Who sets the rest of the action.
        alpha: 0 accurate hand ... 1 stable base.
    """

    def __init__(self, policy: Policy, alpha: float) -> None:
        self._policy, self._alpha = policy, alpha
        self.name = f"{policy.name}, alpha {alpha:g}"
        self._chosen: float | None = None

    def describe(self) -> dict[str, Any]:
        """The alpha, and the policy's own settings."""
        return {"alpha": self._alpha, **self._policy.describe()}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """A new episode of the policy, too."""
        self._policy.begin(rng, layout)
        self._mode = layout.columns("control_mode")
        self._place = layout.settings("alpha")
        self._chosen = None

    def act(self, state: np.ndarray) -> np.ndarray:
        """The policy's action with the held alpha."""
        seen = state.copy()
        if self._chosen is not None:
            seen[self._mode] = self._chosen
        action = self._policy.act(seen).copy()
        self._chosen = float(action[self._place].item())
        action[self._place] = self._alpha
        return action


def worth_rows(
    policy: Policy,
    task: str,
    goals: int,
    seed: int,
    alphas: Sequence[float] = ALPHAS,
    overrides: Mapping[str, Any] | None = None,
    workers: int = 1,
    advance: Advance = silent,
) -> tuple[list[Row], list[Episode]]:
    """Returns per goal, with the learnt alpha and with each fixed one.

    Args:
        policy: A trained agent.
        task: Task that it was trained in.
        goals: Number of goals, half ahead.
        seed: Seed of the goals.
        alphas: Alphas that are held.
        overrides: Settings of the task that are replaced.
        workers: Processes.
        advance: Told the episodes.

    Returns:
        Rows of ``alpha`` (a number or ``learnt``), goal, direction, success and return;
        and the episodes with the learnt alpha.
    """
    config = make_task(task, overrides)
    plans = goal_set(config, goals, seed)
    rows: list[Row] = []
    learnt: list[Episode] = []
    actors: list[tuple[float | str, Policy]] = [(LEARNT, policy)]
    actors += [(alpha, FixedAlpha(policy, alpha)) for alpha in alphas]
    with Rollouts(config, workers) as rollouts:
        for alpha, actor in actors:
            for episode in rollouts.run(actor, plans):
                rows.append(
                    {
                        "task": task,
                        "alpha": alpha,
                        "goal": episode.index,
                        "direction": episode.direction,
                        "success": int(episode.success),
                        "steps": len(episode),
                        "return": episode.episode_return,
                    }
                )
                if alpha == LEARNT:
                    learnt.append(episode)
                advance(1, f"{task} alpha {alpha}")
    return rows, learnt


def summarize_worth(rows: Sequence[Row]) -> list[Row]:
    """One row per setting, seed and fixed alpha: how much better the learnt one is.

    The difference is paired, goal by goal; its interval is by bootstrap over goals.
    """
    cells = dict.fromkeys((row["setting"], row["seed"]) for row in rows)
    return [one for cell in cells for one in _summarize_agent(rows, *cell)]


def _summarize_agent(rows: Sequence[Row], setting: str, seed: int) -> Iterator[Row]:
    rows = [row for row in rows if (row["setting"], row["seed"]) == (setting, seed)]
    learnt = _returns(rows, LEARNT)
    alphas = dict.fromkeys(row["alpha"] for row in rows if row["alpha"] != LEARNT)
    for alpha in alphas:
        own = [row for row in rows if row["alpha"] == alpha]
        difference = learnt - _returns(rows, alpha)
        yield {
            "setting": setting,
            "task": own[0]["task"],
            "seed": seed,
            "alpha": alpha,
            "goals": len(own),
            "success": float(np.mean([row["success"] for row in own])),
            "return": float(np.mean([row["return"] for row in own])),
            "learnt_return": float(np.mean(learnt)),
            "difference": float(np.mean(difference)),
            "difference_interval": bootstrap_interval(difference),
            "better_on": int((difference > 0).sum()),
        }


def alpha_steps(task: str, episodes: Sequence[Episode]) -> Iterator[Row]:
    """Alpha at each step of the episodes that come to it, by direction."""
    for direction in ("forward", "backward"):
        own = [alphas(e) for e in episodes if e.direction == direction]
        for step in range(max(map(len, own), default=0)):
            values = [one[step] for one in own if len(one) > step]
            yield {
                "task": task,
                "direction": direction,
                "step": step + 1,
                "episodes": len(values),
                "mean": float(np.mean(values)),
                "std": float(np.std(values)),
            }


def _returns(rows: Sequence[Row], alpha: float | str) -> np.ndarray:
    own = [row for row in rows if row["alpha"] == alpha]
    return np.array([row["return"] for row in sorted(own, key=lambda r: r["goal"])])


def worth_table(summary: Sequence[Row], labels: Mapping[str, str]) -> str:
    """The learnt alpha against the best one held, an agent a row, as Markdown.

    Args:
        summary: Rows of ``summarize_worth``.
        labels: Descriptions of the settings by name.
    """
    lines = []
    for cell in dict.fromkeys((row["setting"], row["seed"]) for row in summary):
        own = [row for row in summary if (row["setting"], row["seed"]) == cell]
        best = max(own, key=lambda row: float(row["return"]))
        low, high = best["difference_interval"]
        lines.append(
            (
                labels[best["setting"]],
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
