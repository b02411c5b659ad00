"""The named datasets that ship: the code as it is now gives them, to the bit.

Fingerprints of recipes count numbers, not code: these tests count the code, too.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import marl_mm
from marl_mm.collectors.registry import COLLECTORS
from marl_mm.collectors.replay import replay
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.dataset import Dataset
from marl_mm.datasets.location import SHIPPED, locate
from marl_mm.datasets.named import name_of
from marl_mm.datasets.shipped import IDS, description_file, shipped_arrays
from marl_mm.envs.registry import make_task
from marl_mm.runs.collecting import Collecting, collect_dataset
from marl_mm.runs.recipes import RECIPES, recorded
from marl_mm.sim.config import engine_overrides

NAMES = [name_of(name) or name for name in IDS if name != SHIPPED]
"""Names of the named datasets that ship."""


@pytest.mark.parametrize("name", NAMES)
def test_a_dataset_that_ships_begins_as_it_is_collected_now(
    name: str, datasets_home: Path
) -> None:
    """Its first three episodes: a longer dataset begins with the shorter."""
    source = RECIPES.get(name).source
    ships = shipped_arrays(source.name)
    first = arrays_of([ships.episode(number) for number in range(3)], source.name)
    few = Collecting(
        steps=first.steps, seed=source.seed, task=source.task, engine=source.engine
    )
    location = locate("first")
    collect_dataset(location, source.collector, source.config, few)
    made = marl_mm.load_dataset("first").arrays
    assert len(made) == 3 and made.info.keys() == first.info.keys()
    for field in ("states", "actions", "rewards", "lengths", "terminated", "truncated"):
        now, then = getattr(made, field), getattr(first, field)
        assert now.dtype == then.dtype and now.tobytes() == then.tobytes(), field
    for field, values in first.info.items():
        assert made.info[field].tobytes() == values.tobytes(), field


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_scripts_decide_in_every_state_as_they_did(name: str) -> None:
    """In all of them: a constant of the script may matter in few."""
    source = RECIPES.get(name).source
    task = make_task(source.task, engine_overrides(source.engine))
    policy = COLLECTORS.get(source.collector).policy(source.config, task)
    ships = shipped_arrays(source.name)
    for number in range(len(ships)):
        episode = ships.episode(number)
        policy.begin(np.random.default_rng([episode.seed, 1]), task.layout)  # as it was
        acts = np.stack([policy.act(state) for state in episode.states[:-1]])
        assert acts.astype(np.float32).tobytes() == episode.actions.tobytes(), number


def test_failures_of_noisy_data_are_replayed_to_the_bit() -> None:
    location = locate("quiet-zone-noisy")
    ships = shipped_arrays(location.id)
    failed = np.flatnonzero(~ships.successes())[[0, 1, -2, -1]]
    some = arrays_of([ships.episode(number) for number in failed], location.id)
    about = {"marl_mm": json.loads(description_file(location.id).read_text())}
    assert list(replay(Dataset(location, about, some))) == [None] * 4


@pytest.mark.parametrize("name", NAMES)
def test_a_dataset_that_ships_has_the_numbers_on_record(name: str) -> None:
    arrays, row = shipped_arrays(RECIPES.get(name).source.name), recorded()[name]
    assert (arrays.steps, len(arrays)) == (row["steps"], row["episodes"])
    assert float(arrays.successes().mean()) == row["success"]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_dataset_that_ships_has_the_hash_on_record(
    name: str, datasets_home: Path
) -> None:
    data, row = marl_mm.load_dataset(name), recorded()[name]
    assert data.metadata["marl_mm"]["data_sha256"] == row["data_sha256"]
