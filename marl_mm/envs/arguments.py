"""Arguments that all kinds of environments have: render mode, seed and options."""

import math
from collections.abc import Mapping
from operator import index
from typing import Any, NoReturn

import numpy as np

from marl_mm.envs.task import Task
from marl_mm.errors import UsageError, meant
from marl_mm.layout import Layout, places
from marl_mm.sim.config import RATE

RENDER_MODES = ("rgb_array",)
"""Modes of rendering: pictures. ``EpisodeCore(gui=True)`` opens PyBullet's window."""


def render_metadata(task: Task) -> dict[str, Any]:
    """Metadata of rendering as Gymnasium and PettingZoo expect them.

    ``render_fps`` counts pictures per simulated second: one picture a step.
    """
    return {
        "render_modes": list(RENDER_MODES),
        "render_fps": RATE / task.ticks_per_step,
    }


def check_render_mode(mode: str | None) -> None:
    """Raise for an unknown render mode.

    Raises:
        UsageError: If it is neither None nor one of ``RENDER_MODES``.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise UsageError(
            f"render_mode is {mode!r}, expected {' or '.join(RENDER_MODES)} or None"
        )


def checked_seed(seed: Any) -> int | None:
    """A seed of an episode as an integer of Python's; None is none.

    Raises:
        UsageError: If it is no integer >= 0.
    """
    try:
        number = None if seed is None else index(seed)
    except TypeError:
        number = -1
    if isinstance(seed, bool):
        number = -1
    if number is not None and number < 0:
        raise UsageError(f"seed is {seed!r:.60}, expected an integer >= 0, or None")
    return number


def checked_options(options: Any, layout: Layout, *more: str) -> dict[str, Any]:
    """Options of a reset; none where they are None.

    Args:
        options: The options.
        layout: Layout of the goal.
        more: Names of options beside ``"goal"``.

    Raises:
        UsageError: If they are no mapping, a name is misspelt, or the goal makes no
            sense.
    """
    if options is not None and not isinstance(options, Mapping):
        raise UsageError(
            f"options are {options!r:.60}, expected a mapping, such as {{'goal': ...}}"
        )
    asked, known = dict(options or {}), ("goal", *more)
    for name in asked.keys() - set(known):
        if hint := meant(str(name), known):  # others may be for a wrapper
            raise UsageError(f"there is no option {name!r}{hint}")
    if asked.get("goal") is not None:
        asked["goal"] = checked_goal(asked["goal"], layout)
    return asked


def checked_goal(goal: Any, layout: Layout) -> np.ndarray:
    """A goal as an array of its own, shape (g,), float64.

    Raises:
        UsageError: If it has another shape, is not finite or beyond the bounds of its
            entries.
    """
    entries = [layout.state[i] for i in places(layout.state_names, layout.desired)]
    try:
        values = np.array(goal, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (len(entries),) or not all(
        math.isfinite(value) and entry.low <= value <= entry.high
        for entry, value in zip(entries, values, strict=True)
    ):
        expected = ", ".join(map(str, entries))
        raise UsageError(
            f"goal is {goal!r}, expected {len(entries)} finite numbers: {expected}"
        )
    return values


def refuse_copies(environment: Any) -> NoReturn:
    """``__reduce__`` of environments, which hold a simulator.

    Raises:
        UsageError: Always.
    """
    raise UsageError(
        "an environment cannot be copied or pickled: make another, with the same seed "
        "and actions"
    )
