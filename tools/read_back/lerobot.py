"""Reads an export with LeRobot's ``LeRobotDataset``; see ``reference.py``."""

import sys

here = sys.path.pop(0)  # or this file would be imported in place of the library
import numpy as np  # noqa: E402
from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402

sys.path.append(here)
from compare import ends, report  # noqa: E402

exported, reference = sys.argv[1:]
known = np.load(reference)
dataset = LeRobotDataset("marl_mm/exported", root=exported)
print(dataset.meta.names["action"], dataset.fps, dataset[0]["task"])
rows = [dataset[i] for i in range(len(dataset))]
lengths = known["lengths"]
last = ends(lengths)
within = np.arange(len(last)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
expected = {
    "observation.state": known["observations"],
    "action": known["actions"],
    "next.reward": known["rewards"],
    "next.done": last,
    "next.terminated": known["terminals"],
    "episode_index": np.repeat(np.arange(len(lengths)), lengths),
    "frame_index": within,
    "timestamp": within / dataset.fps,
}
read = {key: np.stack([row[key].numpy() for row in rows]) for key in expected}
episodes = dataset.meta.episodes
statistics = dataset.meta.stats["observation.state"]
report(
    "lerobot",
    read
    | {key: episodes[key] for key in ("length", "dataset_to_index")}
    | {key: statistics[key] for key in ("min", "max")},
    expected
    | {"length": lengths, "dataset_to_index": np.cumsum(lengths)}
    | {
        name: getattr(known["observations"].astype(np.float32), name)(axis=0)
        for name in ("min", "max")
    },
)
