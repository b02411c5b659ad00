"""Tasks and their environments, for one agent (Gymnasium) or several (PettingZoo)."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from marl_mm.envs.registry import TASKS, make_task, register_task

if TYPE_CHECKING:
    from marl_mm.envs.parallel import TeamEnv as parallel_env
    from marl_mm.envs.parallel_vector import TeamVector as parallel_vec
    from marl_mm.envs.vector import GoalVector as make_vec

__all__ = [
    "TASKS",
    "make_task",
    "make_vec",
    "parallel_env",
    "parallel_vec",
    "register_task",
]

_ENVIRONMENTS = {
    "make_vec": ("vector", "GoalVector"),
    "parallel_env": ("parallel", "TeamEnv"),
    "parallel_vec": ("parallel_vector", "TeamVector"),
}
"""Modules and names of the environments' classes."""


def __getattr__(name: str) -> Any:
    """An environment when it is asked for: the simulator comes with it."""
    if name not in _ENVIRONMENTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, environment = _ENVIRONMENTS[name]
    return getattr(import_module(f"{__name__}.{module}"), environment)


def __dir__() -> list[str]:
    return sorted({*globals(), *_ENVIRONMENTS})
