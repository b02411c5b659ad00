"""The suite of disturbances by which the robustness of policies is measured."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import product
from typing import Any

from marl_mm.envs.load import LoadConfig
from marl_mm.envs.registry import make_task, merged
from marl_mm.envs.task import Task
from marl_mm.errors import UsageError
from marl_mm.eval.disturbances import Disturbed, Dropped, Frozen, Late, Noisy
from marl_mm.eval.evaluate import check_task
from marl_mm.sim.config import ENGINES

Changes = Mapping[str, Any]
"""Fields of a task that are replaced, nested as it is."""


@dataclass(frozen=True, kw_only=True)
class Disturbance:
    """A way to disturb one agent, each in turn, or the task."""

    about: str
    """Description, with the meaning of the strengths."""

    how: type[Disturbed] | Callable[[Task, Any], Changes]
    """Class of policies with a disturbed agent; or function of a task and a strength
    that returns the fields to replace, and raises a ``UsageError`` that says why the
    disturbance does not apply."""

    strengths: tuple[float | str, ...]
    """Strengths from the weakest to the strongest, in ``unit``."""

    unit: str = ""
    """Unit of the strengths."""


def payload(task: Task, factor: float) -> Changes:
    """A load of so many times the largest mass, or the task's own mass likewise.

    Raises:
        UsageError: If the task has nothing to carry.
    """
    load = getattr(task, "load", None)
    if isinstance(load, LoadConfig):
        return {"load": {"mass": (factor * load.mass[1],) * 2}}
    masses = [each.name for each in fields(task) if each.name.endswith("mass")]
    if not masses:
        raise UsageError("the task has nothing to carry")
    return {name: factor * getattr(task, name) for name in masses}


def pad_friction(task: Task, factor: float) -> Changes:
    """So many times the least friction between block and pads.

    Raises:
        UsageError: If no block is held by friction.
    """
    load = getattr(task, "load", None)
    if not (isinstance(load, LoadConfig) and load.grasp == "friction"):
        raise UsageError("the task has no block that friction holds")
    return {"load": {"friction": (factor * load.friction[0],) * 2}}


def wheel_friction(task: Task, factor: float) -> Changes:
    """So many times the friction between drive wheels and ground."""
    return {"simulation": {"wheel_friction": factor * task.simulation.wheel_friction}}


def other_engine(task: Task, which: str) -> Changes:
    """The engine that the task is not on.

    Raises:
        UsageError: If the engine is not installed, or lacks the task.
    """
    (other,) = (name for name in ENGINES if name != task.simulation.engine)
    check_task(replace(task, simulation=replace(task.simulation, engine=other)))
    return {"simulation": {"engine": other}}


ROBUSTNESS = {
    "late": Disturbance(
        about="an agent's actions come so many steps later, until then its first one",
        how=Late,
        strengths=(1, 2, 3),
        unit="steps",
    ),
    "dropped": Disturbance(
        about="this share of an agent's views is lost: it sees the last one again",
        how=Dropped,
        strengths=(0.25, 0.5, 0.75),
    ),
    "frozen": Disturbance(
        about="after so many actions an agent repeats the last one to the end",
        how=Frozen,
        strengths=(12, 6, 3),
        unit="actions",
    ),
    "noisy": Disturbance(
        about="Gaussian noise on an agent's view, in standard deviations of each entry "
        "over the steps of the clean run",
        how=Noisy,
        strengths=(0.05, 0.1, 0.2),
        unit="std",
    ),
    "payload": Disturbance(
        about="so many times the largest mass of the load",
        how=payload,
        strengths=(1.25, 1.5, 2.0),
        unit="x",
    ),
    "pad friction": Disturbance(
        about="so many times the least friction between block and pads",
        how=pad_friction,
        strengths=(0.5, 0.25, 0.1),
        unit="x",
    ),
    "wheel friction": Disturbance(
        about="so many times the friction between drive wheels and ground",
        how=wheel_friction,
        strengths=(0.2, 0.05, 0.02),
        unit="x",
    ),
    "engine": Disturbance(
        about="the engine that the clean run is not on",
        how=other_engine,
        strengths=("other",),
    ),
}
"""Disturbances by name."""


@dataclass(frozen=True)
class Condition:
    """A disturbance of one strength, of one agent or of the task."""

    disturbance: str
    """Name of the disturbance."""

    agent: str
    """Name of the agent; empty for the task."""

    strength: float | str
    """Strength, in the disturbance's unit."""

    overrides: Changes = field(hash=False)
    """Fields of the task that are replaced, those of the clean run among them."""

    def __str__(self) -> str:
        return " ".join(filter(None, (self.disturbance, self.agent, self.amount)))

    @property
    def amount(self) -> str:
        """The strength with its unit."""
        unit = ROBUSTNESS[self.disturbance].unit
        unit = unit.removesuffix("s") if self.strength == 1 else unit
        return f"{self.strength} {unit}".strip()


def conditions(
    task: str, overrides: Changes, names: Sequence[str]
) -> tuple[list[Condition], dict[str, str]]:
    """Conditions of a task, and why disturbances do not apply, by their names.

    Args:
        task: Registered name of the task.
        overrides: Fields of the task that are replaced in the clean run.
        names: Names of the disturbances.

    Raises:
        UsageError: If there is no such disturbance, or one is named twice.
    """
    if len(set(names)) < len(names):
        raise UsageError(f"disturbances are {' '.join(names)}, expected each once")
    clean = make_task(task, overrides)
    agents = [agent.name for agent in clean.layout.team]
    listed: list[Condition] = []
    left_out: dict[str, str] = {}
    for name in names:
        if name not in ROBUSTNESS:
            choices = ", ".join(ROBUSTNESS)
            raise UsageError(f"no disturbance {name!r}, expected some of {choices}")
        how, strengths = ROBUSTNESS[name].how, ROBUSTNESS[name].strengths
        if isinstance(how, type):
            listed += [
                Condition(name, *pair, overrides) for pair in product(agents, strengths)
            ]
            continue
        try:
            changed = [merged(overrides, how(clean, each)) for each in strengths]
            for each in changed:
                make_task(task, each)  # raises
        except UsageError as error:
            left_out[name] = str(error)
        else:
            pairs = zip(strengths, changed, strict=True)
            listed += [Condition(name, "", *pair) for pair in pairs]
    return listed, left_out
