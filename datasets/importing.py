"""Import of files of others: Minari's episodes or flat HDF5 arrays."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.datasets.hdf5 import (
    FILE,
    ROBOT_NUMBERS,
    Field,
    checked,
    episode_fields,
    episode_groups,
    is_of_episodes,
    optional,
    states_of,
)
from marl_mm.datasets.hdf5_files import open_hdf5, reading_limits
from marl_mm.datasets.metadata import METADATA_BYTES
from marl_mm.datasets.plausible import problems_of
from marl_mm.envs.registry import DEFAULT, make_task
from marl_mm.envs.task import Task
from marl_mm.episode import IMPORTED, Episode
from marl_mm.errors import DatasetError, UsageError, WorkerDiedError
from marl_mm.layout import Layout
from marl_mm.layout_diff import refuse_other_layout
from marl_mm.received import (
    check_regular,
    parse_json,
    read_json,
    refuse_links_out,
)
from marl_mm.registry import Registry
from marl_mm.sim.config import ENGINES, Engine, engine_of
from marl_mm.version1 import dataset_layout
from marl_mm.workers import apart

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


@dataclass(frozen=True)
class Foreign:
    """Contents of a file that others wrote."""

    arrays: EpisodeArrays
    """Arrays of all episodes."""

    task: str
    """Registered name of the task whose rewards these are."""

    engine: Engine | None
    """Engine of the simulation; None where the file names none."""


def read_foreign(path: Path, dataset_id: str, task: str | None = None) -> Foreign:
    """The episodes of a file that others wrote.

    Args:
        path: HDF5 file, or folder of a Minari dataset.
        dataset_id: Id of the dataset that is made of it.
        task: Registered name of the task whose rewards these are; default the file's
            own, or Reach-v0 if it names none.

    Raises:
        UsageError: If there is no such file or task, or the file's layout is not the
            task's.
        DatasetError: If the file cannot be read, or holds impossible values. The
            message names the key, what was got and what was expected.
    """
    for name in (f"data/{FILE}", FILE):
        if (path / name).exists():
            refuse_links_out(path, (name, "data/metadata.json"), DatasetError)
            path = path / name
    if path.is_dir() or not path.exists():
        what = "is a folder without" if path.is_dir() else "does not exist, nor"
        raise UsageError(
            f"{path} {what} {FILE}: expected an HDF5 file or a Minari dataset's folder"
        )
    size = check_regular(path, DatasetError)
    if not h5py.is_hdf5(path):
        raise DatasetError(f"{path} is no HDF5 file, or a damaged one ({size} bytes)")
    limits = reading_limits(size)
    try:
        name = task or apart(_task_of, path, *limits) or DEFAULT
        arrays, engine = apart(_read, (path, dataset_id, name), *limits)
    except UsageError as error:
        way_out = "" if task else ", or give `task`"
        raise UsageError(f"{path}: {error}{way_out}") from error
    except WorkerDiedError as error:
        raise DatasetError(
            f"{path} is damaged: the HDF5 library cannot read it ({error})"
        ) from error
    if problems := problems_of(arrays):
        raise DatasetError(f"{path}: {'; '.join(problems)}")
    return Foreign(arrays, name, engine)


def _task_of(path: Path) -> str | None:
    """Name of the task in a file; reading a damaged file can crash or never end."""
    with open_hdf5(path) as file:
        task = _metadata(path, file).get("task")
    return task if isinstance(task, str) else None


def _read(arguments: tuple[Path, str, str]) -> tuple[EpisodeArrays, Engine | None]:
    """Episodes and engine of a file; arguments: path, the dataset's id, the task."""
    path, dataset_id, name = arguments
    task = make_task(name)
    with open_hdf5(path) as file:
        forms = [form for _, form in reversed(IMPORTS.items()) if form.fits(file)]
        metadata = _metadata(path, file)
        layout = _layout(metadata)
        if layout is not None:
            agents = forms[0].by_agent
            refuse_other_layout("its data", layout, name, task.layout, agents)
        episodes = forms[0].episodes(path, file, task.layout, list(task.info))
    return _judged(arrays_of(episodes, dataset_id), task), _engine(metadata)


def _judged(arrays: EpisodeArrays, task: Task) -> EpisodeArrays:
    """Episodes with their success, where the file does not say it.

    An episode that ended has reached its goal, unless its task can fail too: then the
    task's own rule decides, from the state after the step.
    """
    told = np.asarray(arrays.info["is_success"], np.float64)
    if not np.isnan(told).any():
        return arrays
    hit = arrays.terminated
    if task.fails:
        after = arrays.states[~arrays.is_first_state()]
        achieved, goal = after[:, arrays.layout.achieved], after[:, arrays.layout.goal]
        terms = arrays.reward_terms(task.needs)
        hit = hit & task.reached(achieved, goal, terms)
    success = np.where(np.isnan(told), hit, told == 1)
    return replace(arrays, info={**arrays.info, "is_success": success})


def _engine(metadata: Mapping[str, Any]) -> Engine | None:
    """Engine in a file's attributes, or in our metadata beside it."""
    engine, overrides = metadata.get("engine"), metadata.get("overrides")
    if isinstance(overrides, Mapping):
        engine = engine_of(overrides)
    return engine if engine in ENGINES else None


def _metadata(path: Path, file: Any) -> Mapping[str, Any]:
    """Attributes of a file, or our metadata beside it."""
    if "task" in file.attrs:
        return dict(file.attrs)
    beside = path.parent / "metadata.json"
    metadata = None
    if beside.exists():
        metadata = read_json(beside, DatasetError, METADATA_BYTES)
    record = metadata.get("marl_mm") if isinstance(metadata, dict) else None
    return record if isinstance(record, dict) else {}


def _layout(metadata: Mapping[str, Any]) -> Layout | None:
    """The layout in the metadata, or the one of version 1 with the same entries."""
    layout = metadata.get("layout")
    if layout is None:
        return dataset_layout(metadata) if "state" in metadata else None
    if isinstance(layout, str):
        layout = parse_json(layout, "the layout in the file", DatasetError)
    return Layout.from_json(layout)


def _episode(
    path: Path, number: int, group: Any, layout: Layout, names: list[str]
) -> Episode:
    """An episode of Minari's format with goal-dictionary observations."""
    values = checked(path, group, episode_fields(layout))
    info = {key: optional(group, f"infos/{key}") for key in names}
    seed = group.attrs.get("seed", -1)
    return _built(
        number,
        states_of(values, layout),
        values["actions"],
        values["rewards"],
        values["terminations"],
        values["truncations"],
        info,
        int(seed) if _is_seed(seed) else -1,
        layout,
    )


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
    success = optional(file, "infos/is_success")
    if success is not None and success.shape != values["terminals"].shape:
        raise DatasetError(
            f"{path}: 'infos/is_success' has shape {success.shape}, expected "
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
                {
                    **dict.fromkeys(names),
                    "is_success": None if success is None else success[part],
                },
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
