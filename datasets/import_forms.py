"""Forms of files of others: Minari's episodes or flat HDF5 arrays."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.datasets.hdf5 import (
    ACHIEVED,
    ROBOT_NUMBERS,
    Field,
    checked,
    episode_fields,
    episode_groups,
    is_of_episodes,
    optional,
    states_of,
)
from marl_mm.datasets.metadata import SUCCESS
from marl_mm.episode import IMPORTED, Episode
from marl_mm.errors import DatasetError
from marl_mm.layout import Layout
from marl_mm.registry import Registry

_SHARED = (
    Field("rewards", "float"),
    Field("terminals", "number"),
    Field("timeouts", "number"),
)


def flat_fields(layout: Layout) -> tuple[Field, ...]:
    """Arrays of the flat form, as in D4RL; ``export`` writes it, too."""
    state = len(layout.state)
    return (
        *_SHARED,
        Field("observations", "float", state),
        Field("actions", "float", len(layout.action)),
        Field("next_observations", "float", state),
    )


def agents_fields(layout: Layout) -> tuple[Field, ...]:
    """Arrays of the form with one group per agent."""
    state = len(layout.state)
    return (
        *_SHARED,
        Field("state", "float", state),
        Field("next_state", "float", state),
        *(
            Field(f"{agent.name}/actions", "float", len(agent.action))
            for agent in layout.agents
        ),
    )


_SAME = 1e-4
"""Tolerance within which two observations count as equal (files may store float32)."""


@dataclass(frozen=True, kw_only=True)
class ImportForm:
    """A form of import: a format of episodes in an HDF5 file."""

    about: str
    """Sentence that describes the file."""

    fits: Callable[[Any], bool]
    """Whether an open file is of this form; the first form that fits is taken."""

    episodes: Callable[[Path, Any, Layout, list[str]], list[Episode]]
    """Function that reads the episodes of an open file. It is given the file's path,
    the file, the layout and the names of the step numbers."""

    by_agent: bool = False
    """Whether actions are stored by agent, so that the agents have to be equal."""


IMPORTS: Registry[ImportForm] = Registry("form", of=ImportForm)
"""All forms of import by name; the last one added is tried first."""


def _episode(
    path: Path, number: int, group: Any, layout: Layout, names: list[str]
) -> Episode:
    """An episode of Minari's format with goal-dictionary observations."""
    values = checked(path, group, episode_fields(layout))
    states = states_of(values, layout)
    other = np.abs(states[:, layout.achieved] - values[ACHIEVED]) > _SAME
    if other.any():
        raise DatasetError(
            f"{path}, episode {number}: 'achieved_goal' is not what the observations "
            f"say of {', '.join(layout.compared)}"
        )
    shape = values["rewards"].shape
    infos = _infos(path, group, names).items()
    info = {name: _of_steps(given, *shape) for name, given in infos}
    success = info[SUCCESS]
    if success is not None and success.shape != shape:
        raise DatasetError(
            f"{path}, episode {number}: 'infos/{SUCCESS}' has shape {success.shape}, "
            f"expected {shape}"
        )
    seed = group.attrs.get("seed", -1)
    return _built(
        number,
        states,
        values["actions"],
        values["rewards"],
        values["terminations"],
        values["truncations"],
        info,
        int(seed) if _is_seed(seed) else -1,
        layout,
    )


def _infos(path: Path, group: Any, names: list[str]) -> dict[str, np.ndarray | None]:
    """Step numbers by name; None of what the file lacks, or has as something else."""
    info = {name: optional(group, f"infos/{name}") for name in names}
    if info[SUCCESS] is None and f"infos/{SUCCESS}" in group:
        raise DatasetError(f"{path}: 'infos/{SUCCESS}' is no array of numbers")
    return info


def _of_steps(given: np.ndarray | None, steps: int) -> np.ndarray | None:
    """Step numbers without that of the reset, which Minari may store in front."""
    return given if given is None or given.shape[:1] != (steps + 1,) else given[1:]


def _is_seed(value: Any) -> bool:
    return isinstance(value, int | np.integer) and 0 <= int(value) < 2**63


def _minari(path: Path, file: Any, layout: Layout, names: list[str]) -> list[Episode]:
    groups = enumerate(episode_groups(path, file))
    return [_episode(path, i, group, layout, names) for i, group in groups]


def _flat(path: Path, file: Any, layout: Layout, names: list[str]) -> list[Episode]:
    values = checked(path, file, flat_fields(layout))
    return _flat_episodes(path, file, values, layout, names)


def _agents(path: Path, file: Any, layout: Layout, names: list[str]) -> list[Episode]:
    values = checked(path, file, agents_fields(layout))
    values["observations"] = values["state"]
    values["next_observations"] = values["next_state"]
    actions = np.empty((len(values["rewards"]), len(layout.action)))
    for agent in layout.agents:
        actions[:, list(agent.action)] = values[f"{agent.name}/actions"]
    return _flat_episodes(path, file, {**values, "actions": actions}, layout, names)


def _flat_episodes(
    path: Path,
    file: Any,
    values: dict[str, np.ndarray],
    layout: Layout,
    names: list[str],
) -> list[Episode]:
    for key in ("terminals", "timeouts"):
        if not np.isin(values[key], (0, 1)).all():
            raise DatasetError(f"{path}: {key!r} holds other values than 0 and 1")
    info = _infos(path, file, names)
    for name, told in info.items():
        if told is not None and told.shape != values["terminals"].shape:
            raise DatasetError(
                f"{path}: 'infos/{name}' has shape {told.shape}, expected "
                f"{values['terminals'].shape}"
            )
    terminated = values["terminals"].astype(bool)
    truncated = values["timeouts"].astype(bool)
    ends = np.flatnonzero(terminated | truncated) + 1
    if not len(ends) or ends[-1] != len(terminated):
        raise DatasetError(
            f"{path}: the last step has neither 'terminals' nor 'timeouts': the last "
            "episode has no end"
        )
    inner = ~(terminated | truncated)[:-1]
    jumps = values["next_observations"][:-1] - values["observations"][1:]
    count = int((np.abs(jumps[inner]) > _SAME).any(axis=1).sum())
    if count:
        raise DatasetError(
            f"{path}: {count} steps within an episode have 'next_observations' that "
            "are not the next step's 'observations'"
        )
    episodes = []
    for number, (begin, end) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
        part = slice(begin, end)
        last = values["next_observations"][end - 1 : end]
        episodes.append(
            _built(
                number,
                np.concatenate([values["observations"][part], last]),
                values["actions"][part],
                values["rewards"][part],
                terminated[part],
                truncated[part],
                {n: None if told is None else told[part] for n, told in info.items()},
                -1,
                layout,
            )
        )
    return episodes


def _built(
    number: int,
    states: np.ndarray,
    actions: np.ndarray,
    rewards: np.ndarray,
    terminated: np.ndarray,
    truncated: np.ndarray,
    info: dict[str, np.ndarray | None],
    seed: int,
    layout: Layout,
) -> Episode:
    """An episode in our types; step numbers that the file lacks are NaN."""
    states = states.astype(np.float64)
    way = states[1:, layout.achieved] - states[1:, layout.goal]
    derived = {"distance": np.linalg.norm(way, axis=1)}
    unknown = np.full(len(rewards), np.nan)
    measured = {
        key: derived.get(key, unknown)
        if value is None or value.shape != rewards.shape
        else value
        for key, value in info.items()
    }
    return Episode(
        states=states,
        actions=actions.astype(np.float32),
        rewards=rewards.astype(np.float64),
        terminated=terminated,
        truncated=truncated,
        info=measured,
        seed=seed,
        index=number,
        source=IMPORTED,
        start=np.full(ROBOT_NUMBERS, np.nan),
        layout=layout,
    )


IMPORTS.add(
    "flat",
    ImportForm(
        about="Joint arrays as in D4RL: observations, actions, next_observations, "
        "rewards, terminals, timeouts.",
        fits=lambda file: True,
        episodes=_flat,
    ),
)
IMPORTS.add(
    "agents",
    ImportForm(
        about="One group per agent, state and next_state, as export writes them.",
        fits=lambda file: "state" in file and "observations" not in file,
        episodes=_agents,
        by_agent=True,
    ),
)
IMPORTS.add(
    "minari",
    ImportForm(
        about="Minari's episodes with goal-dictionary observations.",
        fits=is_of_episodes,
        episodes=_minari,
    ),
)
