"""Whether d3rlpy reads and trains from our datasets; by hand, in its own environment.

d3rlpy 2.8.1 pins gymnasium 1.0.0, so it cannot be installed beside marl_mm::

    python3.11 -m venv d3 && d3/bin/pip install d3rlpy==2.8.1 minari==0.5.4 h5py
    d3/bin/pip install --no-deps -e . && d3/bin/pip install pybullet==3.2.7 pin \
        proxsuite numba safetensors tensorboard tyro rich matplotlib pettingzoo
    d3/bin/python tests/other/d3rlpy_reads.py

What it printed on 2026-11-21 (d3rlpy 2.8.1, Minari 0.5.4) ``get_minari``
gives all 504 episodes and 5,000 transitions and TD3+BC trains from them, but from the
second episode on observations are those of other steps (up to 2.3 m off):
d3rlpy cuts observations, of which every Minari episode has one more than actions, at
the actions' ends. It does so with every Minari dataset. Its own ``MDPDataset`` made of
the flat arrays is right (0.0), so that is the way to take.
"""

import d3rlpy
import numpy as np
from d3rlpy.dataset import MDPDataset
from d3rlpy.datasets import get_minari

from marl_mm.datasets import load_dataset

ID = "marl_mm/reach/good-5k-v0"


def main() -> None:
    ours = load_dataset(ID)  # unpacks it
    theirs, env = get_minari(ID)
    joint = ours.joint()
    flat = MDPDataset(
        joint.observation,
        joint.action,
        joint.reward,
        terminals=joint.terminated,
        timeouts=joint.truncated,
    )
    print(f"{theirs.size()} episodes, {theirs.transition_count} transitions, {env}")
    for name, dataset in (("get_minari", theirs), ("MDPDataset", flat)):
        worst = max(
            float(np.abs(np.asarray(one.observations) - other.states[:-1]).max())
            for one, other in zip(dataset.episodes, ours.episodes, strict=True)
        )
        print(f"{name}: observations at most {worst} off")
        algorithm = d3rlpy.algos.TD3PlusBCConfig(batch_size=64).create(device="cpu")
        algorithm.fit(dataset, n_steps=300, n_steps_per_epoch=300, show_progress=False)


if __name__ == "__main__":
    main()
