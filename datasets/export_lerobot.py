"""Export to version 3 of LeRobot's datasets: Parquet files and their description.

A frame is a step: ``observation.state`` before it, ``action``, and what came of it as
``next.reward``, ``next.done`` (the episode ended) and ``next.terminated`` (it ended in
the task, not by running out of steps). The state after an episode's last step has no
action, and so no place.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.export import (
    DATASET_FORMS,
    DatasetForm,
    Tables,
    description,
    episode_steps,
)
from marl_mm.envs.registry import make_task

_MARK = "meta/info.json"

_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

_EPISODES = "meta/episodes/chunk-000/file-000.parquet"

_QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
"""Those that LeRobot keeps."""


def _lerobot(dataset: Dataset, path: Path) -> None:
    provenance = dataset.provenance
    task = make_task(provenance.task, provenance.overrides)
    rate = 1 / task.seconds_per_step
    steps, frames = episode_steps(dataset), _frames(dataset, rate)
    _write_parquet(path / _DATA.format(chunk_index=0, file_index=0), frames)
    _write_parquet(path / _EPISODES, _episodes(steps, frames, task.about))
    tasks = {"task_index": np.zeros(1, np.int64), "task": [task.about]}
    _write_parquet(path / "meta/tasks.parquet", tasks, index="task")
    info = {
        "codebase_version": "v3.0",
        "robot_type": "marl_mm",
        "total_episodes": len(steps),
        "total_frames": len(frames["index"]),
        "total_tasks": 1,
        "chunks_size": 1_000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": int(rate) if rate.is_integer() else rate,
        "splits": {"train": f"0:{len(steps)}"},
        "data_path": _DATA,
        "video_path": None,
        "features": _features(dataset, frames),
        "marl_mm": description(dataset, "lerobot"),
    }
    stats = {key: _statistics(values) for key, values in frames.items()}
    for name, value in ((_MARK, info), ("meta/stats.json", stats)):
        (path / name).write_text(json.dumps(value, indent=2) + "\n", "utf-8")


def _frames(dataset: Dataset, rate: float) -> Tables:
    """Columns of the steps by key, floating ones in float32."""
    joint, lengths = dataset.joint(), dataset.arrays.lengths
    count = len(joint)
    within = np.arange(count) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return {
        "observation.state": joint.observation.astype(np.float32),
        "action": joint.action,
        "next.reward": joint.reward.astype(np.float32),
        "next.done": joint.terminated | joint.truncated,
        "next.terminated": joint.terminated,
        "timestamp": (within / rate).astype(np.float32),
        "frame_index": within,
        "episode_index": joint.episode,
        "index": np.arange(count),
        "task_index": np.zeros(count, np.int64),
    }


def _features(dataset: Dataset, frames: Tables) -> dict[str, Any]:
    """Types, shapes and names of the columns; an action's has its agent in front."""
    layout = dataset.arrays.layout
    owner = {name: agent.name for agent in layout.team for name in agent.sets}
    names = {
        "observation.state": list(layout.state_names),
        "action": [f"{owner[name]}.{name}" for name in layout.action_names],
    }
    return {
        key: {
            "dtype": str(values.dtype),
            "shape": list(values.shape[1:]) or [1],
            "names": names.get(key),
        }
        for key, values in frames.items()
    }


def _episodes(steps: list[slice], frames: Tables, task: str) -> dict[str, Any]:
    """Columns of the episodes by key."""
    none = np.zeros(len(steps), np.int64)
    begins, ends = (np.array([getattr(s, e) for s in steps]) for e in ("start", "stop"))
    columns: dict[str, Any] = {
        "episode_index": np.arange(len(steps)),
        "tasks": [[task]] * len(steps),
        "length": ends - begins,
        "data/chunk_index": none,
        "data/file_index": none,
        "dataset_from_index": begins,
        "dataset_to_index": ends,
        "meta/episodes/chunk_index": none,
        "meta/episodes/file_index": none,
    }
    for key, values in frames.items():
        rows = [_statistics(values[part]) for part in steps]
        for name in rows[0]:
            columns[f"stats/{key}/{name}"] = [row[name] for row in rows]
    return columns


def _statistics(values: np.ndarray) -> dict[str, list[Any]]:
    """Statistics of each entry of a column, and the number of rows."""
    rows = values.reshape(len(values), -1)
    rows = rows if rows.dtype == bool else rows.astype(np.float64)
    ends = {"min": rows.min(axis=0), "max": rows.max(axis=0)}
    quantiles = np.quantile(rows.astype(np.float64), _QUANTILES, axis=0)
    return {
        **{name: value.tolist() for name, value in ends.items()},
        "mean": rows.mean(axis=0).tolist(),
        "std": rows.std(axis=0).tolist(),
        "count": [len(rows)],
        **{
            f"q{round(100 * share):02d}": value.tolist()
            for share, value in zip(_QUANTILES, quantiles, strict=True)
        },
    }


def _write_parquet(
    path: Path, columns: Mapping[str, Any], index: str | None = None
) -> None:
    """Write columns by key; ``index`` names the one that pandas takes as index."""
    import pyarrow
    from pyarrow import parquet

    arrays = {
        key: pyarrow.FixedSizeListArray.from_arrays(values.ravel(), values.shape[1])
        if isinstance(values, np.ndarray) and values.ndim == 2
        else pyarrow.array(values)
        for key, values in columns.items()
    }
    table = pyarrow.table(arrays)
    if index is not None:
        entry = {"name": index, "field_name": index, "metadata": None}
        kinds = {"pandas_type": "unicode", "numpy_type": "object"}
        about = {
            "index_columns": [index],
            "columns": [entry | kinds],
            "column_indexes": [],
        }
        table = table.replace_schema_metadata({"pandas": json.dumps(about)})
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        parquet.write_table(table, file)


DATASET_FORMS.add(
    "lerobot",
    DatasetForm(
        about="LeRobot's version 3, in float32; actions are named AGENT.ENTRY.",
        write=_lerobot,
        mark=(_MARK, '"form": "lerobot"'),
        holds=("data/*", "meta/*"),
        packages=("pyarrow",),
    ),
)
