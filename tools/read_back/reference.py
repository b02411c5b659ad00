"""What a dataset holds, as plain arrays that need nothing of this package to be read.

    python tools/read_back/reference.py DATASET REFERENCE.npz

Each script beside this one runs in an environment of its own, which has one library
and not marl_mm, reads what ``marl-mm datasets export`` wrote with that library's own
loader, and compares every value with the reference::

    PYTHON_WITH_THE_LIBRARY tools/read_back/LIBRARY.py EXPORTED REFERENCE.npz
"""

import sys
from pathlib import Path

import numpy as np

from marl_mm.datasets import load_dataset


def main(name: str, path: str) -> None:
    """Write the reference of a dataset."""
    dataset = load_dataset(name)
    joint = dataset.joint()
    arrays = {
        "observations": joint.observation,
        "actions": joint.action,
        "rewards": joint.reward,
        "next_observations": joint.next_observation,
        "terminals": joint.terminated,
        "timeouts": joint.truncated,
        "lengths": dataset.arrays.lengths,
        "agents": np.array([*dataset.agents()]),
    }
    for agent, view in dataset.agents().items():
        arrays[f"{agent}/observations"] = view.observation
        arrays[f"{agent}/actions"] = view.action
        arrays[f"{agent}/next_observations"] = view.next_observation
    with Path(path).open("wb") as file:
        np.savez_compressed(file, **arrays)


if __name__ == "__main__":
    main(*sys.argv[1:])
