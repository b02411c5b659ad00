"""The registry of tasks, and tasks with some fields replaced."""

import inspect
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

import gymnasium

from marl_mm.declared import defaults, like
from marl_mm.envs.task import Task
from marl_mm.episode import FAILED, GOAL_INFO, MOTION_INFO
from marl_mm.errors import UsageError, meant
from marl_mm.layout import Layout
from marl_mm.registry import Registry

KINDS = (
    *("reach", "carry", "grasp"),
    *("quiet_zone", "gate", "tray", "moving_reach", "bar", "course"),
)
"""Names of the files of built-in tasks."""

TASKS: Registry[Task] = Registry(
    "task",
    [f"marl_mm.envs.tasks.{kind}" for kind in KINDS],
    of=Task,
)
"""All tasks by name."""

_RESERVED = {*GOAL_INFO, *MOTION_INFO, FAILED, "reason"}
"""Names of step numbers that are not a task's own."""

DEFAULT = "Reach-v0"
"""Name of the default task."""


def register_task(name: str, task: Task) -> None:
    """Register a task by name, with Gymnasium as ``marl_mm/NAME``, too.

    Raises:
        UsageError: If it is no task, has no layout or a field without a default, or a
            step number that every task has, or the name is another task's or does not
            end in a version.
    """
    if not re.fullmatch(r".+-v(0|[1-9]\d*)", str(name)):
        raise UsageError(f"task {name!r}: expected a version, such as {name}-v0")
    if isinstance(task, Task):
        defaults(type(task))
        _refuse_untyped(type(task))
        if not isinstance(getattr(task, "layout", None), Layout):
            raise UsageError(f"task {name!r}: {type(task).__name__} has no layout")
        if taken := sorted(_RESERVED & set(task.own_info)):
            raise UsageError(
                f"task {name!r}: own_info of {type(task).__name__} has {taken[0]!r}, "
                "a step number of every task: give it another name"
            )
    TASKS.add(name, task, caller=2)
    gymnasium.registry.pop(f"marl_mm/{name}", None)  # a task that is replaced
    gymnasium.register(
        id=f"marl_mm/{name}",
        entry_point="marl_mm.envs.goal_env:GoalEnv",
        kwargs={"task": name},
    )


def _refuse_untyped(kind: type[Task]) -> None:
    """Raise for what is written like a field of a class, but is none or not a new one.

    Raises:
        UsageError: Naming the class and what to write.
    """
    known = {item.name for item in fields(kind)}
    for base in kind.__mro__:
        if not issubclass(base, Task):
            continue
        typed = inspect.get_annotations(base)
        own = [name for name, of in typed.items() if "ClassVar" not in str(of)]
        if own and "__dataclass_fields__" not in vars(base):
            raise UsageError(
                f"{base.__name__}.{own[0]} has no effect: write "
                f"@dataclass(frozen=True, kw_only=True) above class {base.__name__}"
            )
        if untyped := sorted(known & vars(base).keys() - typed.keys()):
            name, value = untyped[0], vars(base)[untyped[0]]
            raise UsageError(
                f"{base.__name__}.{name} has no effect without a type: write "
                f"{name}: {type(value).__name__} = {value!r:.60}"
            )


def kind_of(name: str) -> str:
    """Name of the task of which another one is a level or the like.

    It is Gate-v0 of Gate-easy-v0 and Gate-v0; a task that has no such name is its own.
    """
    kind, dash, _ = name.removesuffix("-v0").partition("-")
    dash = dash if name.endswith("-v0") else ""
    return f"{kind}-v0" if dash and f"{kind}-v0" in TASKS else name


def make_task(name: str = DEFAULT, overrides: Mapping[str, Any] | None = None) -> Task:
    """A registered task, with some of its fields replaced.

    Args:
        name: Registered name of the task.
        overrides: Fields to replace, nested as the task is, for example
            ``{"max_steps": 50, "controller": {"form": "rhp"}}``.

    Raises:
        UsageError: If the task or a field does not exist, or a value is of another type
            or makes no sense.
    """
    task: Task = _replaced(TASKS.get(name), overrides or {}, "")
    return task


def merged(overrides: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Overrides of ``make_task``, with others on top of them, nested as they are."""
    result = dict(overrides)
    for name, value in changes.items():
        before = result.get(name)
        if isinstance(before, Mapping) and isinstance(value, Mapping):
            value = merged(before, value)
        result[name] = value
    return result


def fewest_steps(name: str, least: int) -> int:
    """Number of steps of a quick episode of a task: as few as it allows.

    Args:
        name: Registered name of the task.
        least: Number of steps, if the task does not need more of them.
    """
    own = TASKS.get(name).max_steps
    for steps in range(least, own):
        try:
            return make_task(name, {"max_steps": steps}).max_steps
        except UsageError:  # nobody gets to the goal in so few
            continue
    return own


def config_dict(config: Any) -> Any:
    """A config as nested dictionaries of JSON values."""
    if is_dataclass(config):
        return {f.name: config_dict(getattr(config, f.name)) for f in fields(config)}
    if hasattr(config, "_asdict"):
        return {name: config_dict(value) for name, value in config._asdict().items()}
    return config


def _replaced(config: Any, overrides: Mapping[str, Any], path: str) -> Any:
    if is_dataclass(config):
        known = [item.name for item in fields(config)]
    else:
        known = list(config._fields)
    if not isinstance(overrides, Mapping):
        raise UsageError(f"overrides are {overrides!r:.60}, expected a mapping")
    changes = {}
    for name, value in overrides.items():
        if not isinstance(name, str):
            raise UsageError(f"a field is {name!r:.60}, expected a name")
        if name not in known:
            raise UsageError(
                f"unknown field {path + name!r}{meant(name, known)}, expected one of "
                f"{', '.join(known)}"
            )
        current = getattr(config, name)
        if is_dataclass(current) or hasattr(current, "_asdict"):
            if not isinstance(value, Mapping):
                raise UsageError(
                    f"{path}{name} is {value!r}, expected a mapping of its fields"
                )
            changes[name] = _replaced(current, value, f"{path}{name}.")
        else:
            changes[name] = like(value, current, path + name)
    if is_dataclass(config) and not isinstance(config, type):
        return replace(config, **changes)
    return config._replace(**changes)
