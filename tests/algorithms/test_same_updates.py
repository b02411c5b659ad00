"""First updates stay as they were: committed rows could not be made again otherwise.

If one is to change, rows of its algorithm have to be trained anew; then write the new
actions with ``python -m tests.algorithms.test_same_updates``.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.registry import ALGORITHMS, TUNED, names
from marl_mm.datasets.shipped import shipped_arrays
from marl_mm.envs.registry import make_task

ACTIONS = Path(__file__).parents[1] / "fixtures" / "same_updates.json"

UPDATES = 20

SMALL = {"hidden": (16, 16), "batch_size": 32}

ALL = names(online=False) + names(online=True)


def policy_of(name: str) -> LearnedPolicy:
    """Policy after some updates, with the default preset but for sizes."""
    algorithm, arrays, task = ALGORITHMS.get(name), shipped_arrays(), make_task()
    config = algorithm.presets[TUNED]
    if algorithm.online:
        changed = replace(config, **SMALL, warm_up=8)
        learner = algorithm.learner(changed, task, 3, (), task.layout)
        for number in range(8):
            learner.observe(arrays.episode(number))
        learner.learn(UPDATES)
        return LearnedPolicy(name, learner.agents, learner.layout)
    changed = replace(config, **SMALL, precision="highest")
    learner = algorithm.learner(changed, arrays, task, (3,), "cpu")
    for _ in range(UPDATES):
        learner.update()
    return LearnedPolicy(name, learner.agents(0), learner.layout)


def acted(name: str) -> list[list[float]]:
    """Actions in a few states, and those that are planned there for the next steps."""
    policy, actions = policy_of(name), []
    for number, state in enumerate(shipped_arrays().states[[0, 1_000, 2_000]]):
        policy.begin(np.random.default_rng(number), policy.layout)
        for _ in range(getattr(ALGORITHMS.get(name).presets[TUNED], "chunk", 1)):
            actions.append([round(float(entry), 6) for entry in policy.act(state)])
    return actions


@pytest.mark.parametrize("name", ALL)
def test_first_updates_stay_as_they_were(name: str) -> None:
    """To 1e-4: on a processor with other instructions they differ by 1e-6."""
    kept = json.loads(ACTIONS.read_text())
    np.testing.assert_allclose(acted(name), kept[name], rtol=0, atol=1e-4)


if __name__ == "__main__":
    lines = (f' "{name}": {acted(name)}' for name in ALL)
    ACTIONS.write_text("{\n" + ",\n".join(lines) + "\n}\n")
