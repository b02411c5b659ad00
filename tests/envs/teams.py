"""Teams of the tasks in which the team decides: experts whose actions are changed."""

from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import numpy as np

from marl_mm.envs.core import EpisodeCore
from marl_mm.envs.registry import TASKS, make_task
from marl_mm.envs.rollout import EpisodePlan, episode_seed, run_episode
from marl_mm.envs.task import ScriptConfig, Values
from marl_mm.episode import Episode
from marl_mm.layout import Layout

MUJOCO = {"simulation": {"engine": "mujoco"}}
KINDS = ("QuietZone", "Gate", "Tray", "MovingReach", "Bar", "Course")

Change = Callable[[dict[str, float], Values], Any]


class Changed:
    """The task's expert, whose actions a function changes."""

    name = "changed"

    def __init__(self, task: str, change: Change | None = None) -> None:
        self._task, self._change = TASKS.get(task), change

    def describe(self) -> dict[str, Any]:
        return {}

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        pass

    def act(self, state: np.ndarray) -> np.ndarray:
        layout = self._task.layout
        seen = dict(zip(layout.state_names, state.tolist(), strict=True))
        action = dict(self._task.expert(seen, ScriptConfig()))
        if self._change is not None:
            self._change(action, seen)
        return np.array([action[name] for name in layout.action_names], np.float32)


def episodes(
    task: str, number: int, change: Change | None = None, **overrides: Any
) -> Iterator[Episode]:
    with closing(EpisodeCore(make_task(task, MUJOCO | overrides))) as core:
        for i in range(number):
            plan = EpisodePlan(i, episode_seed(11, i, "evaluate"))
            yield run_episode(core, Changed(task, change), plan)


def held(alpha: float) -> Change:
    def change(action: dict[str, float], seen: Values) -> None:
        action |= {name: alpha for name in action if name.endswith("alpha")}

    return change


def reasons(task: str, change: Change, number: int = 3) -> set[str | None]:
    return {episode.reason for episode in episodes(task, number, change)}
