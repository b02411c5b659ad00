"""What alpha does: the PD agent at fixed alphas, and at one that depends on the state.

``Reach-v0`` and ``SmoothReach-v0`` differ in their reward alone, so that one run serves
both. Episodes run for 50 steps, for success within 25 and within 50; the return is that
of the registered task, which ends after 25.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.control.config import Form
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.envs.rollout import run_episodes
from marl_mm.episode import Episode, reward_terms
from marl_mm.eval.goals import goal_set
from marl_mm.eval.intervals import bootstrap_interval, success_interval
from marl_mm.eval.metrics import Row

LONG_EPISODE, SHORT_EPISODE = 50, 25
"""Steps that an episode has, and steps of the registered tasks."""

RUNS = {
    "Reach-v0": ("Reach-v0", "SmoothReach-v0"),
    "PreciseReach-v0": ("PreciseReach-v0",),
}
"""Tasks to run, and the tasks whose rewards each run gives."""


@dataclass(frozen=True)
class SweepCell:
    """One setting of the sweep: everything its rows depend on."""

    task: str
    """Run; see ``RUNS`` for those that give others' rewards, too."""

    form: Form
    pd: PdConfig
    goals: int
    """Half ahead, half behind."""

    seed: int
    """Of the goals."""

    max_steps: int = LONG_EPISODE

    mass: float | None = None
    """Of what is carried [kg]; None: nothing is."""

    def to_json(self) -> dict[str, Any]:
        """Everything, JSON-serialisable."""
        return asdict(self)

    @property
    def overrides(self) -> dict[str, Any]:
        """Of the task."""
        own: dict[str, Any] = {
            "max_steps": self.max_steps,
            "controller": {"form": self.form},
        }
        if self.mass is not None:
            own["load"] = {"mass": (self.mass, self.mass)}
        return own


def run_cell(cell: SweepCell) -> list[Row]:
    """One row per goal and task."""
    config = make_task(cell.task, cell.overrides)
    plans = goal_set(config, cell.goals, cell.seed)
    policy = PdPolicy(cell.pd)
    episodes = run_episodes(config, policy, plans)
    return [row for episode in episodes for row in episode_rows(cell, episode)]


def episode_rows(cell: SweepCell, episode: Episode) -> Iterable[Row]:
    """An episode's row for each task that it serves."""
    info, steps = episode.info, len(episode)
    load = {} if cell.mass is None else {"mass": cell.mass}
    for task in RUNS.get(cell.task, (cell.task,)):
        reward = episode.rewards
        if task != cell.task:
            other, layout = TASKS.get(task), episode.layout
            after = episode.states[1:]
            terms = reward_terms(other.needs, info, episode.failed, after, layout)
            achieved, goals = after[:, layout.achieved], after[:, layout.goal]
            reward = other.reward(achieved, goals, terms)
        yield {
            "task": task,
            "form": cell.form,
            "rule": cell.pd.alpha_rule,
            "alpha": cell.pd.alpha,
            "seed": cell.seed,
            "max_steps": cell.max_steps,
            "goal": episode.index,
            "direction": episode.direction,
            "success": int(episode.success),
            "steps": steps,
            "return": float(reward[:SHORT_EPISODE].sum()),
            "d_mm": float(info["d_mm"].mean()),
            "d_mp": float(info["d_mp"].mean()),
            "base_jerk_rms": float(info["base_jerk_rms"].mean()),
            "zmp_margin": float(info["zmp_margin"].min()),
            "qp_failures": int(info["qp_failures"].sum()),
            **load,
        }


def summarize_cells(rows: Sequence[Row]) -> list[Row]:
    """One row per task, form, rule, alpha and direction: means over goals."""
    keys = sorted({_key(row) for row in rows})
    summaries = []
    for key in keys:
        own = [row for row in rows if _key(row) == key]
        task, form, rule, alpha, direction = key
        successes = [
            row["steps"] <= SHORT_EPISODE and row["success"] == 1 for row in own
        ]
        summaries.append(
            {
                "task": task,
                "form": form,
                "rule": rule,
                "alpha": alpha,
                "direction": direction,
                "goals": len(own),
                "d_mm": _mean(own, "d_mm"),
                "d_mp": _mean(own, "d_mp"),
                "steps": _mean(own, "steps"),
                "success_25": float(np.mean(successes)),
                "success_25_interval": success_interval(sum(successes), len(own)),
                "success_50": _mean(own, "success"),
                "base_jerk_rms": _mean(own, "base_jerk_rms"),
                "zmp_margin": min(row["zmp_margin"] for row in own),
                "return": _mean(own, "return"),
                "qp_failures": sum(row["qp_failures"] for row in own),
            }
        )
    return summaries


def _key(row: Row) -> tuple[str, str, str, float, str]:
    return row["task"], row["form"], row["rule"], row["alpha"], row["direction"]


def _mean(rows: Sequence[Row], name: str) -> float:
    return float(np.mean([row[name] for row in rows]))


@dataclass(frozen=True)
class Response:
    """How the robot answers to alpha, going backward."""

    task: str
    form: str
    largest_share: float
    """Of the whole change in steps, made by one step of the alpha grid."""

    at: float
    """The alpha below that step."""

    d_mm_falls: float
    """Largest decrease of d_mm from one alpha to the next [m]; it should grow."""

    d_mp_rises: float
    """Largest increase of d_mp from one alpha to the next [m]; it should fall."""

    hump: float
    """Forward d_mm at its worst alpha, beyond the larger of both ends' [m]."""


def responses(summaries: Sequence[Row]) -> list[Response]:
    """One per task and form, from the rows of the fixed alphas."""
    fixed = [row for row in summaries if row["rule"] == "constant"]
    found = []
    for task, form in sorted({(row["task"], row["form"]) for row in fixed}):
        own = [row for row in fixed if (row["task"], row["form"]) == (task, form)]
        back = sorted(
            (row for row in own if row["direction"] == "backward"),
            key=lambda row: row["alpha"],
        )
        ahead = sorted(
            (row for row in own if row["direction"] == "forward"),
            key=lambda row: row["alpha"],
        )
        steps = np.array([row["steps"] for row in back])
        shares = np.diff(steps) / max(steps[-1] - steps[0], 1e-9)
        hand = np.array([row["d_mm"] for row in ahead])
        found.append(
            Response(
                task,
                form,
                float(shares.max()),
                back[int(shares.argmax())]["alpha"],
                float(-np.diff([row["d_mm"] for row in back]).min()),
                float(np.diff([row["d_mp"] for row in back]).max()),
                float(hand.max() - max(hand[0], hand[-1])),
            )
        )
    return found


def worth_of_a_rule(rows: Sequence[Row], task: str) -> list[Row]:
    """Return of each rule less that of every fixed alpha, paired by goal.

    With a 95 % bootstrap interval of the mean difference; rules and alphas have to have
    run on the same goals.
    """
    own = [row for row in rows if row["task"] == task]
    rules = sorted({(r["rule"], r["alpha"]) for r in own if r["rule"] != "constant"})
    alphas = sorted({row["alpha"] for row in own if row["rule"] == "constant"})
    found = []
    for rule, lowest in rules:
        with_rule = _returns(own, rule, lowest)
        for alpha in alphas:
            fixed = _returns(own, "constant", alpha)
            difference = np.array([with_rule[goal] - fixed[goal] for goal in fixed])
            low, high = bootstrap_interval(difference)
            found.append(
                {
                    "task": task,
                    "rule": rule,
                    "lowest_alpha": lowest,
                    "fixed_alpha": alpha,
                    "goals": len(difference),
                    "return_rule": float(np.mean(list(with_rule.values()))),
                    "return_fixed": float(np.mean(list(fixed.values()))),
                    "difference": float(difference.mean()),
                    "interval": [low, high],
                    "better_on": int((difference > 0).sum()),
                }
            )
    return found


def _returns(rows: Sequence[Row], rule: str, alpha: float) -> dict[int, float]:
    return {
        row["goal"]: row["return"]
        for row in rows
        if (row["rule"], row["alpha"]) == (rule, alpha)
    }
