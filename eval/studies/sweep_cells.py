"""Episodes of the alpha sweep: the PD agent at fixed alphas, and by rules of the state.

``Reach-v0`` and ``SmoothReach-v0`` differ in their reward alone, so that one run serves
both. Episodes run for 50 steps, for success within 25 and within 50; the return is that
of the registered task, which ends after 25. Loads are carried on ``CarryReach-v0``.
"""

from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

from marl_mm.collectors.pd import PdConfig, PdPolicy
from marl_mm.control.config import Form
from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.drive import Drive, Tick
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.envs.rollout import run_episode
from marl_mm.episode import Episode, reward_terms
from marl_mm.eval.goals import goal_set
from marl_mm.eval.metrics import Row
from marl_mm.robot.description import CASTER_X
from marl_mm.sim.config import Engine, default_engine, engine_overrides
from marl_mm.versions import engine_text

LONG_EPISODE, SHORT_EPISODE = 50, 25
"""Steps of an episode, and steps of the registered tasks' episodes."""

RUNS = {
    "Reach-v0": ("Reach-v0", "SmoothReach-v0"),
    "PreciseReach-v0": ("PreciseReach-v0",),
}
"""Tasks to run, and the tasks whose rewards each run gives."""

MASSES = (0.1, 1.0, 2.0, 3.0)
"""Masses of loads [kg]."""

LOAD_ALPHAS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Alphas with which loads are carried."""


@dataclass(frozen=True)
class SweepCell:
    """One setting of the sweep: everything its rows depend on."""

    task: str
    """Task that is run; see ``RUNS`` for those that give others' rewards, too."""

    form: Form
    """Form in which alpha enters the controller."""

    pd: PdConfig
    """Settings of the PD agent."""

    goals: int
    """Number of goals, half ahead, half behind."""

    seed: int
    """Seed of the goals."""

    max_steps: int = LONG_EPISODE
    """Steps of an episode."""

    mass: float | None = None
    """Mass of the load [kg]; None: no load."""

    engine: Engine = field(default_factory=default_engine)
    """Engine of the simulation."""

    @property
    def label(self) -> str:
        """Label in the progress bar."""
        return f"{self.task} {self.form} alpha {self.pd.alpha:g}"

    @property
    def overrides(self) -> dict[str, Any]:
        """Settings of the task that are replaced."""
        settings: dict[str, Any] = {
            "max_steps": self.max_steps,
            "controller": {"form": self.form},
            **engine_overrides(self.engine),
        }
        if self.mass is not None:
            settings["load"] = {"mass": (self.mass, self.mass)}
        return settings


def load_cells(goals: int, seed: int) -> list[SweepCell]:
    """Cells of every mass at every alpha, on the same goals.

    Args:
        goals: Number of goals, half ahead, half behind.
        seed: Seed of the goals.
    """
    return [
        SweepCell("CarryReach-v0", "blend", PdConfig(alpha=a), goals, seed, mass=mass)
        for mass in MASSES
        for a in LOAD_ALPHAS
    ]


class _Swing:
    """Fore-aft positions of the zero-moment point, every few ticks."""

    def __init__(self, drive: Drive, every: int) -> None:
        self._drive, self._every = drive, every
        self._x: list[float] = []

    def see(self, tick: Tick) -> None:
        if tick.number % self._every == 0:
            self._x.append(self._drive.zmp_b(tick.state, tick.command)[0])

    def to_row(self) -> Row:
        front, rear = CASTER_X
        least, most = min(self._x), max(self._x)
        return {
            "zmp_fore_aft": min(front - most, least - rear),
            "zmp_span": most - least,
        }


def run_cell(cell: SweepCell) -> list[Row]:
    """One row per goal and task; with a load also what the zero-moment point did.

    ``zmp_fore_aft`` is its least distance to the support's front or rear edge,
    ``zmp_span`` how far it went from end to end [m]: the margin to all edges is nearly
    always that to the sides, which the base's way ahead does not change.
    """
    config = make_task(cell.task, cell.overrides)
    policy, rows = PdPolicy(cell.pd), []
    with closing(EpisodeCore(config)) as core:
        for plan in goal_set(config, cell.goals, cell.seed):
            swing = _Swing(core.drive, config.look_every)
            looks = cell.mass is not None
            episode = run_episode(core, policy, plan, swing.see if looks else None)
            more = swing.to_row() if looks else {}
            rows += [{**row, **more} for row in episode_rows(cell, episode)]
    return rows


def episode_rows(cell: SweepCell, episode: Episode) -> Iterable[Row]:
    """An episode's row for each task that it serves."""
    info, steps = episode.info, len(episode)
    load = {} if cell.mass is None else {"mass": cell.mass}
    engine = {"engine": engine_text(cell.engine)}
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
            **engine,
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
