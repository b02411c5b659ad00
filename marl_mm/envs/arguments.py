"""Arguments that all kinds of environments have: render mode, seed and options."""

from collections.abc import Mapping
from operator import index
from typing import Any

from marl_mm.envs.task import Task
from marl_mm.errors import UsageError
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
    if number is not None and number < 0:
        raise UsageError(f"seed is {seed!r:.60}, expected an integer >= 0, or None")
    return number


def checked_options(options: Any) -> Mapping[str, Any]:
    """Options of a reset; none where they are None.

    Raises:
        UsageError: If they are no mapping.
    """
    if options is not None and not isinstance(options, Mapping):
        raise UsageError(
            f"options are {options!r:.60}, expected a mapping, such as {{'goal': ...}}"
        )
    return options or {}
