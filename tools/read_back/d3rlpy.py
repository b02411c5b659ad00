"""Reads an export with d3rlpy's ``ReplayBuffer.load``; see ``reference.py``."""

import sys
from pathlib import Path

here = sys.path.pop(0)  # or this file would be imported in place of the library
import d3rlpy  # noqa: E402
import numpy as np  # noqa: E402

sys.path.append(here)
from compare import ends, report  # noqa: E402

exported, reference = sys.argv[1:]
with Path(exported).open("rb") as file:
    buffer = d3rlpy.dataset.ReplayBuffer.load(file, d3rlpy.dataset.InfiniteBuffer())
known = np.load(reference)
last = ends(known["lengths"])
picked = [
    buffer.transition_picker(episode, step)
    for episode in buffer.episodes
    for step in range(episode.transition_count)
]
begins_and_goes_on = known["terminals"] | ~last  # d3rlpy drops a timeout's transition
report(
    "d3rlpy",
    {
        "observations": np.concatenate([e.observations for e in buffer.episodes]),
        "actions": np.concatenate([e.actions for e in buffer.episodes]),
        "rewards": np.concatenate([e.rewards for e in buffer.episodes])[:, 0],
        "terminated": [e.terminated for e in buffer.episodes],
        "lengths": [e.size() for e in buffer.episodes],
        "transition observations": [step.observation for step in picked],
        "transition terminals": [step.terminal for step in picked],
        "next_observations": [
            step.next_observation for step in picked if not step.terminal
        ],
    },
    {
        **{key: known[key] for key in ("observations", "actions", "rewards")},
        "terminated": known["terminals"][last],
        "lengths": known["lengths"],
        "transition observations": known["observations"][begins_and_goes_on],
        "transition terminals": known["terminals"][begins_and_goes_on],
        "next_observations": known["next_observations"][~last],
    },
)
