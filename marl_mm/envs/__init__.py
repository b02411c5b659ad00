"""Tasks and their environments, for one agent (Gymnasium) or several (PettingZoo)."""

from typing import TYPE_CHECKING, Any

from marl_mm.envs.registry import TASKS, make_task, register_task

if TYPE_CHECKING:
    from marl_mm.envs.parallel import TeamEnv as parallel_env

__all__ = ["TASKS", "make_task", "parallel_env", "register_task"]


def __getattr__(name: str) -> Any:
    """The environment when it is asked for: the simulator comes with it."""
    if name != "parallel_env":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from marl_mm.envs.parallel import TeamEnv

    return TeamEnv
