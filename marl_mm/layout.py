"""Layouts: names, units and bounds of a joint state and action, and the agents' parts.

A layout travels with the episodes, datasets, checkpoints and policies it describes. No
number is ever read by its place without the layout that names it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from marl_mm.declared import plain
from marl_mm.errors import LayoutError

JOINT_NAME = "joint"
"""Name of the single actor of algorithms without agents."""

_RESERVED = (
    *(JOINT_NAME, "actor", "critic", "imitation", "flow", "value", "conservative"),
    *("state", "next_state", "rewards", "terminals", "timeouts", "episodes"),
)
"""Names that agents may not have: logs, checkpoints and exported files use them."""

MAX_ENTRIES = 1_000
"""Largest number of entries of a state, of an action, of a list in a file."""

MAX_AGENTS = 8
"""Largest number of agents in a layout."""

Columns = slice | list[int]
"""Index of some entries along an array's last axis."""


@dataclass(frozen=True)
class Entry:
    """One number of a joint state or a joint action."""

    name: str
    """Name: a Python identifier, unique within the state or action."""

    unit: str = "1"
    """Unit of the number; "1" for pure numbers."""

    low: float = -math.inf
    """Lower bound, in the entry's unit."""

    high: float = math.inf
    """Upper bound, in the entry's unit."""

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            bound = plain(getattr(self, name))
            if not isinstance(bound, int | float):
                raise LayoutError(
                    f"entry {self.name!r:.60}: {name} is {bound!r:.60}, expected a "
                    "number"
                )
            object.__setattr__(self, name, bound)

    def __str__(self) -> str:
        bounded = math.isfinite(self.low) or math.isfinite(self.high)
        within = f" in [{self.low:g}, {self.high:g}]" if bounded else ""
        return f"{self.name} [{self.unit}]{within}"


@dataclass(frozen=True)
class Agent:
    """One agent's observation and action, by names of entries."""

    name: str
    """Name of the agent."""

    sees: tuple[str, ...]
    """Names of the joint state's entries, in the order of the agent's observation."""

    sets: tuple[str, ...]
    """Names of the joint action's entries; no two agents set the same entry."""

    def __post_init__(self) -> None:
        _make_tuples(self, "sees", "sets")

    def __str__(self) -> str:
        return f"{self.name} (sees {', '.join(self.sees)}; sets {', '.join(self.sets)})"


@dataclass(frozen=True)
class AgentLayout:
    """One agent's observation and action, by places in the joint state and action."""

    name: str
    """Name of the agent."""

    observation: tuple[int, ...]
    """Places of the observation's entries in the joint state."""

    action: tuple[int, ...]
    """Places of the action's entries in the joint action."""

    low: tuple[float, ...]
    """Lower bounds of the action, in the entries' units."""

    high: tuple[float, ...]
    """Upper bounds of the action, in the entries' units."""


@dataclass(frozen=True)
class Layout:
    """Entries of a joint state and action, the agents, and the goal.

    Raises:
        LayoutError: If names are missing, unknown or not unique, if an action entry has
            no bounds, no agent or several, or if goal and compared entries share one
            or differ in number.
    """

    state: tuple[Entry, ...]
    """Entries of the joint state, in order."""

    action: tuple[Entry, ...]
    """Entries of the joint action, in order; each is bounded."""

    team: tuple[Agent, ...]
    """Agents, in order, 1 to 8 of them."""

    compared: tuple[str, ...]
    """Names of the state's entries that are compared with the goal."""

    desired: tuple[str, ...]
    """Names of the state's entries that hold the goal, as many, in the same order."""

    def __post_init__(self) -> None:
        _make_tuples(self, "state", "action", "team", "compared", "desired")
        _check_kinds(self)
        _check_names("state", self.state_names)
        _check_names("action", self.action_names)
        _check_names("agents", [agent.name for agent in self.team])
        for agent in self.team:
            if agent.name in _RESERVED:
                raise LayoutError(
                    f"an agent is called {agent.name!r}, expected another name than "
                    f"{', '.join(_RESERVED)}"
                )
            if not agent.sees or not agent.sets:
                raise LayoutError(f"agent {agent.name!r} sees or sets no entry")
            _check_names(f"what {agent.name!r} sees", agent.sees)
            _check_among("state", agent.sees, self.state_names, f"{agent.name!r} sees")
        if len(self.team) > MAX_AGENTS:
            raise LayoutError(f"{len(self.team)} agents, expected at most {MAX_AGENTS}")
        sets = [name for agent in self.team for name in agent.sets]
        if sorted(sets) != sorted(self.action_names):
            raise LayoutError(
                f"the agents set {', '.join(sets)}, expected each of "
                f"{', '.join(self.action_names)} once"
            )
        for entry in self.state + self.action:
            if not isinstance(entry.unit, str) or not entry.unit.isprintable():
                raise LayoutError(
                    f"entry {entry.name!r} has the unit {entry.unit!a}, expected a "
                    "word without control characters"
                )
        for entry in self.action:
            if not -math.inf < entry.low < entry.high < math.inf:
                raise LayoutError(f"action entry {entry}: expected finite low < high")
        for entry in self.state:
            if not entry.low < entry.high:
                raise LayoutError(f"state entry {entry}: expected low < high")
        for part, names in (("compared", self.compared), ("desired", self.desired)):
            _check_names(part, names)
            _check_among("state", names, self.state_names, f"{part} has")
        if both := set(self.compared) & set(self.desired):
            raise LayoutError(
                f"{', '.join(sorted(both))} would be compared with itself: expected "
                "other entries in compared than in desired"
            )
        if len(self.compared) != len(self.desired):
            raise LayoutError(
                f"{', '.join(self.compared)} cannot be compared with "
                f"{', '.join(self.desired)}: expected as many entries"
            )

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Names of the joint state's entries."""
        return tuple(entry.name for entry in self.state)

    @cached_property
    def action_names(self) -> tuple[str, ...]:
        """Names of the joint action's entries."""
        return tuple(entry.name for entry in self.action)

    @cached_property
    def low(self) -> tuple[float, ...]:
        """Lower bounds of the joint action, shape (k,), in the entries' units."""
        return tuple(entry.low for entry in self.action)

    @cached_property
    def high(self) -> tuple[float, ...]:
        """Upper bounds of the joint action, shape (k,), in the entries' units."""
        return tuple(entry.high for entry in self.action)

    @cached_property
    def achieved(self) -> Columns:
        """Columns of the state that are compared with the goal."""
        return columns(places(self.state_names, self.compared))

    @cached_property
    def goal(self) -> Columns:
        """Columns of the state that hold the goal."""
        return columns(places(self.state_names, self.desired))

    @cached_property
    def observation(self) -> Columns:
        """Columns of the state without the goal."""
        rest = (name for name in self.state_names if name not in self.desired)
        return columns(places(self.state_names, rest))

    @cached_property
    def agents(self) -> tuple[AgentLayout, ...]:
        """The agents by places in the joint state and action, in order."""
        return tuple(
            self._placed(
                agent.name,
                places(self.state_names, agent.sees),
                places(self.action_names, agent.sets),
            )
            for agent in self.team
        )

    @cached_property
    def joint(self) -> AgentLayout:
        """A single agent that sees and sets it all, for algorithms without agents."""
        seen, sets = range(len(self.state)), range(len(self.action))
        return self._placed(JOINT_NAME, tuple(seen), tuple(sets))

    def columns(self, *names: str) -> Columns:
        """Columns of the state's entries of these names.

        Raises:
            LayoutError: Naming the entries that the state lacks.
        """
        _check_among("state", names, self.state_names, "columns are asked for of")
        return columns(places(self.state_names, names))

    def settings(self, *names: str) -> Columns:
        """Columns of the action's entries of these names.

        Raises:
            LayoutError: Naming the entries that the action lacks.
        """
        _check_among("action", names, self.action_names, "columns are asked for of")
        return columns(places(self.action_names, names))

    def state_of(self, observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Joint states, float64, shape (..., n), of observations and their goals."""
        shape = (*observation.shape[:-1], len(self.state))
        state = np.empty(shape)
        state[..., self.observation], state[..., self.goal] = observation, goal
        return state

    def check_state(self, state: np.ndarray) -> None:
        """Raise for a joint state of another width.

        Raises:
            LayoutError: Naming the entries that it should hold.
        """
        if state.shape != (len(self.state),):
            raise LayoutError(
                f"state has shape {state.shape}, expected ({len(self.state)},): "
                f"{', '.join(self.state_names)}"
            )

    def to_json(self) -> dict[str, Any]:
        """The layout as JSON values; infinite bounds are None."""
        return {
            "state": [_entry_to_json(entry) for entry in self.state],
            "action": [_entry_to_json(entry) for entry in self.action],
            "agents": [[a.name, list(a.sees), list(a.sets)] for a in self.team],
            "compared": list(self.compared),
            "desired": list(self.desired),
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "Layout":
        """The layout of ``to_json``'s values.

        Raises:
            LayoutError: If they are no layout.
        """
        try:
            agents = values["agents"]
            lists = [*values.values(), *(names for agent in agents for names in agent)]
            if max(map(len, lists)) > MAX_ENTRIES:
                raise LayoutError(f"expected at most {MAX_ENTRIES:,} entries")
            return cls(
                tuple(_entry_from_json(*entry) for entry in values["state"]),
                tuple(_entry_from_json(*entry) for entry in values["action"]),
                tuple(
                    Agent(str(name), _names(sees), _names(sets))
                    for name, sees, sets in values["agents"]
                ),
                _names(values["compared"]),
                _names(values["desired"]),
            )
        except LayoutError:
            raise
        except (LookupError, TypeError, ValueError, OverflowError) as error:
            raise LayoutError(f"no layout of marl_mm ({error!r:.80})") from error

    def _placed(
        self, name: str, seen: tuple[int, ...], sets: tuple[int, ...]
    ) -> AgentLayout:
        low, high = (tuple(bound[i] for i in sets) for bound in (self.low, self.high))
        return AgentLayout(name, seen, sets, low, high)


def columns(entries: Sequence[int]) -> Columns:
    """Index of these places: a slice where they are consecutive, which makes views."""
    run = slice(entries[0], entries[-1] + 1) if entries else slice(0, 0)
    return run if list(entries) == list(range(run.start, run.stop)) else list(entries)


def places(names: Sequence[str], chosen: Iterable[str]) -> tuple[int, ...]:
    """Places of the chosen names among all names."""
    return tuple(names.index(name) for name in chosen)


def in_order(agents: Iterable[AgentLayout]) -> list[int] | None:
    """Order that sorts the agents' actions, concatenated, into the joint action.

    None if they are in that order already.
    """
    placed = [place for agent in agents for place in agent.action]
    order = sorted(range(len(placed)), key=placed.__getitem__)
    return None if order == list(range(len(placed))) else order


def _make_tuples(record: Any, *names: str) -> None:
    """Turn lists into tuples, which compare equal and can be hashed."""
    for name in names:
        values = getattr(record, name)
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise LayoutError(f"{name} is {values!r:.60}, expected a tuple")
        object.__setattr__(record, name, tuple(values))


def _check_kinds(layout: Layout) -> None:
    """Raise for parts of other types, or with more entries than a file may have."""
    for name, kind in (("state", Entry), ("action", Entry), ("team", Agent)):
        for part in getattr(layout, name):
            if not isinstance(part, kind):
                raise LayoutError(
                    f"{name} has {part!r:.60}, expected objects of {kind.__name__}"
                )
        if (found := len(getattr(layout, name))) > MAX_ENTRIES:
            raise LayoutError(
                f"{name} has {found:,} entries, expected at most {MAX_ENTRIES:,}"
            )


def _check_names(part: str, names: Sequence[str]) -> None:
    if not names:
        raise LayoutError(f"{part} has no entries, expected at least one")
    for name in names:
        if not isinstance(name, str) or not name.isidentifier():
            raise LayoutError(
                f"{part} has the name {name!r}, expected letters, digits and '_'"
            )
        if names.count(name) > 1:
            raise LayoutError(f"{part} has {name!r} twice, expected it once")


def _check_among(
    part: str, names: Iterable[str], expected: Sequence[str], who: str
) -> None:
    unknown = [name for name in names if name not in expected]
    if unknown:
        raise LayoutError(
            f"{who} {', '.join(unknown)}, which the {part} lacks: expected some of "
            f"{', '.join(expected)}"
        )


def _entry_to_json(entry: Entry) -> list[Any]:
    bounds = (b if math.isfinite(b) else None for b in (entry.low, entry.high))
    return [entry.name, entry.unit, *bounds]


def _entry_from_json(
    name: str, unit: str, low: float | None, high: float | None
) -> Entry:
    return Entry(
        str(name),
        str(unit),
        -math.inf if low is None else float(low),
        math.inf if high is None else float(high),
    )


def _names(values: Iterable[Any]) -> tuple[str, ...]:
    return tuple(map(str, values))
