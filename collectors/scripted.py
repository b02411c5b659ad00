"""The scripted collector: the task's own expert."""

from typing import Any

import numpy as np

from marl_mm.collectors.registry import COLLECTORS, Collector, successes
from marl_mm.declared import as_record
from marl_mm.envs.task import ScriptConfig, Task, Values
from marl_mm.errors import LayoutError
from marl_mm.layout import Layout
from marl_mm.layout_diff import refuse_other_layout


class ScriptedPolicy:
    """Policy of the task's expert.

    Args:
        config: Settings of the expert.
        task: Task whose expert acts.

    Raises:
        UsageError: If the task has no such convention.
    """

    name = "scripted"

    def __init__(self, config: ScriptConfig, task: Task) -> None:
        task.check_script(config)
        self.config, self._task = config, task

    def describe(self) -> dict[str, Any]:
        """The config."""
        return as_record(self.config)

    def begin(self, rng: np.random.Generator, layout: Layout) -> None:
        """Check the layout; the expert has no memory."""
        refuse_other_layout("the script", self._task.layout, "the task", layout)

    def act(self, state: np.ndarray) -> np.ndarray:
        """The expert's action, a function of the joint state."""
        layout = self._task.layout
        seen = dict(zip(layout.state_names, state.tolist(), strict=True))
        return expert_action(self._task, seen, self.config).astype(np.float32)


def expert_action(task: Task, seen: Values, script: ScriptConfig) -> np.ndarray:
    """What the expert of a task does, shape (k,).

    Raises:
        LayoutError: If it leaves out an entry of the action.
    """
    action, names = task.expert(seen, script), task.layout.action_names
    if missing := [name for name in names if name not in action]:
        raise LayoutError(
            f"{type(task).__name__}.expert returns no {', '.join(missing)}, which the "
            "action has"
        )
    return np.array([action[name] for name in names])


COLLECTORS.add(
    "scripted",
    Collector(
        about="Let the task's own expert act; keep the episodes that reach the goal.",
        config=ScriptConfig,
        policy=ScriptedPolicy,
        keeps=successes,
    ),
)
