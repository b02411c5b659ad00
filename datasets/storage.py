"""Minari's HDF5 files: the only module that knows their layout.

One dataset is a folder with ``data/main_data.hdf5`` and ``data/metadata.json``. The
canonical form is joint: goal-dictionary observations, joint action, team reward. Our
own metadata stand under the key ``marl_mm``.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from gymnasium.envs.registration import EnvSpec
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage

from marl_mm.datasets.location import Location, datasets_root, known_ids
from marl_mm.datasets.reference import reference_scores
from marl_mm.episode import INFO, Episode
from marl_mm.errors import DatasetError, UnknownDatasetError, UsageError
from marl_mm.files import new_folder, refuse_existing
from marl_mm.layout import ACTION, AGENTS, EE, GOAL, OBSERVATION, STATE
from marl_mm.spaces import action_space, goal_observation_space
from marl_mm.versions import versions

SCHEMA = 1
"""Version of our metadata."""


def write_dataset(
    location: Location,
    episodes: Sequence[Episode],
    env_spec: EnvSpec,
    description: dict[str, Any],
    overwrite: bool = False,
) -> None:
    """Write a dataset; it appears whole or not at all.

    Args:
        location: Where.
        episodes: In order; at least one.
        env_spec: Of the environment they come from.
        description: Collector's name, its config, seed and the like; JSON-serialisable.
        overwrite: Replace a dataset that is there already.

    Raises:
        OutputExistsError: If it exists and may not be replaced.
        DatasetError: If there are no episodes.
    """
    refuse_existing(location.folder, overwrite)
    refuse_foreign(location)
    if not episodes:
        raise DatasetError(f"no episode to write to {location.folder}")
    with new_folder(location.folder) as temporary:
        storage = MinariStorage.new(
            temporary / "data",
            observation_space=goal_observation_space(),
            action_space=action_space(),
            env_spec=env_spec,
            data_format="hdf5",
        )
        storage.update_metadata(_metadata(location, episodes, description))
        storage.update_episodes(_buffer(episode) for episode in episodes)
        storage.update_episode_metadata(_attributes(episode) for episode in episodes)
    if location.folder == datasets_root() / location.id:
        _name_namespaces(location)


def refuse_foreign(location: Location) -> None:
    """Raise before a folder that holds more than a dataset would be replaced.

    Raises:
        UsageError: If it does.
    """
    folder = location.folder
    if folder.exists() and (
        not folder.is_dir() or {path.name for path in folder.iterdir()} - {"data"}
    ):
        raise UsageError(
            f"{folder} is no dataset, or holds other files too: it is not replaced; "
            "choose another name"
        )


def read_metadata(location: Location) -> dict[str, Any]:
    """A dataset's metadata.

    Raises:
        UnknownDatasetError: If there is no such dataset; the message lists the known.
        DatasetError: If the metadata are damaged or not ours.
    """
    if not location.folder.exists():
        known = ", ".join(known_ids()) or "none"
        raise UnknownDatasetError(
            f"no dataset {location.id!r} at {location.folder}; known ids below "
            f"{datasets_root()}: {known}"
        )
    path = location.data / "metadata.json"
    try:
        metadata: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise DatasetError(f"cannot read {path}: {error}") from error
    ours = metadata.get("marl_mm") if isinstance(metadata, dict) else None
    schema = ours.get("schema") if isinstance(ours, dict) else None
    if schema != SCHEMA or "total_episodes" not in metadata:
        raise DatasetError(
            f"{path} is not of a marl_mm dataset of schema {SCHEMA}: its schema is "
            f"{schema!r}"
        )
    return metadata


def read_episodes(location: Location) -> list[Episode]:
    """All episodes of a dataset, in order.

    Raises:
        UnknownDatasetError: If there is no such dataset.
        DatasetError: If the file is truncated or lacks a key.
    """
    total = read_metadata(location)["total_episodes"]
    path = location.data / "main_data.hdf5"
    try:
        with h5py.File(path, "r") as file:
            episodes = [_episode(file[f"episode_{i}"]) for i in range(total)]
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise DatasetError(
            f"{path} is damaged ({reason}); collect it again with --overwrite"
        ) from error
    for i, episode in enumerate(episodes):
        _check_episode(path, i, episode)
    return episodes


def _check_episode(path: Path, number: int, episode: Episode) -> None:
    """Raise for an episode that cannot be: wrong shapes, or not finite.

    Raises:
        DatasetError: Naming episode and field.
    """
    steps = len(episode.rewards)
    shapes = {
        "states": (steps + 1, len(STATE)),
        "actions": (steps, len(ACTION)),
        "rewards": (steps,),
        "terminated": (steps,),
        "truncated": (steps,),
    }
    for name, expected in shapes.items():
        values = getattr(episode, name)
        if values.shape != expected or steps == 0:
            raise DatasetError(
                f"{path}, episode {number}: {name} have shape {values.shape}, expected "
                f"{expected}; collect it again with --overwrite"
            )
        if not np.isfinite(values).all():
            raise DatasetError(
                f"{path}, episode {number}: {name} hold a NaN or an infinity; collect "
                "it again with --overwrite"
            )


def _metadata(
    location: Location, episodes: Sequence[Episode], description: dict[str, Any]
) -> dict[str, Any]:
    return {
        "dataset_id": location.id,
        "algorithm_name": episodes[0].source,
        "author": {"marl_mm"},
        "description": f"Episodes of {episodes[0].source} on marl_mm.",
        "minari_version": versions()["minari"],
        **reference_scores(description.get("task")),
        "marl_mm": {
            "schema": SCHEMA,
            "state": STATE,
            "action": ACTION,
            "agents": [
                {
                    "name": agent.name,
                    "observation": agent.observation,
                    "action": agent.action,
                }
                for agent in AGENTS
            ],
            "packages": versions(),
            "statistics": _statistics(episodes),
            **description,
        },
    }


def _statistics(episodes: Sequence[Episode]) -> dict[str, Any]:
    states = np.concatenate([episode.states[:-1] for episode in episodes])
    actions = np.concatenate([episode.actions for episode in episodes]).astype(float)
    return {
        "state_mean": states.mean(axis=0).tolist(),
        "state_std": states.std(axis=0).tolist(),
        "action_mean": actions.mean(axis=0).tolist(),
        "action_std": actions.std(axis=0).tolist(),
    }


def _buffer(episode: Episode) -> EpisodeBuffer:
    return EpisodeBuffer(
        seed=episode.seed,
        observations={
            "observation": episode.states[:, OBSERVATION],
            "achieved_goal": episode.states[:, EE],
            "desired_goal": episode.states[:, GOAL],
        },
        actions=episode.actions,
        rewards=episode.rewards,
        terminations=episode.terminated,
        truncations=episode.truncated,
        infos=episode.info,
    )


def _attributes(episode: Episode) -> dict[str, Any]:
    """Per-episode metadata; the first five are those Minari's own collector writes."""
    rewards = episode.rewards
    return {
        "rewards_sum": float(rewards.sum()),
        "rewards_mean": float(rewards.mean()),
        "rewards_std": float(rewards.std()),
        "rewards_min": float(rewards.min()),
        "rewards_max": float(rewards.max()),
        "index": episode.index,
        "collector": episode.source,
        "direction": episode.direction,
        "is_success": episode.success,
    }


def _episode(group: Any) -> Episode:
    observations = group["observations"]
    states = np.concatenate(
        [observations["observation"][()], observations["desired_goal"][()]], axis=1
    )
    return Episode(
        states=states,
        actions=group["actions"][()],
        rewards=group["rewards"][()],
        terminated=group["terminations"][()],
        truncated=group["truncations"][()],
        info={key: group["infos"][key][()] for key in INFO},
        seed=int(group.attrs["seed"]),
        index=int(group.attrs["index"]),
        source=str(group.attrs["collector"]),
    )


def _name_namespaces(location: Location) -> None:
    """Minari lists datasets of a namespace only if the namespace says it is one."""
    folder = Path(location.id).parent
    path = datasets_root() / folder / "namespace_metadata.json"
    if not path.exists():
        path.write_text(json.dumps({"description": "Datasets made by marl_mm."}))
