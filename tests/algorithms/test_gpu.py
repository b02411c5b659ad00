"""On a GPU every algorithm learns what it learns on a CPU; not run without one."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from marl_mm.algorithms.checkpoint import FILE, read_checkpoint
from marl_mm.algorithms.registry import names
from marl_mm.cli import main
from marl_mm.contracts.learners import candidate, demand_same_state, some_episodes
from tests.algorithms.test_train_offline import SMALL, evaluated

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")

UPDATES = 10
SEEDS = (3, 5)


@pytest.mark.parametrize("name", names(online=False))
def test_it_learns_what_a_cpu_learns(name: str) -> None:
    made = candidate(name)
    there, again, here = (
        made.trained(some_episodes(), SEEDS, UPDATES, device)
        for device in ("cuda", "cuda", "cpu")
    )
    for number in range(len(SEEDS)):
        expected = made.weights(here, number)
        repeated = made.weights(again, number)
        for key, value in made.weights(there, number).items():
            np.testing.assert_array_equal(value, repeated[key], key)
            np.testing.assert_allclose(value, expected[key], atol=1e-3, err_msg=key)


@pytest.mark.parametrize("name", ["matd3-bc", "mac-flow"])
def test_runs_go_on_and_are_evaluated(tmp_path: Path, name: str) -> None:
    """Resumed half-way they end where straight ones do, to the bit."""
    words = ["train", name, *SMALL[1:], "--engine", "mujoco", "--device", "cuda"]
    words += ["--seeds", "0", "1"]
    straight, halved = tmp_path / "straight", tmp_path / "halved"
    assert main([*words, "--out", str(straight)]) == 0
    words += ["--out", str(halved)]
    assert main([*words, "--updates", "100"]) == 0
    assert main([*words, "--updates", "300", "--resume"]) == 0
    for seed in ("0", "1"):
        assert evaluated(straight / seed) == evaluated(halved / seed)
        states = [
            read_checkpoint(run / seed / FILE, name)["state"]
            for run in (straight, halved)
        ]
        demand_same_state(*states)


def test_a_study_trains_all_seeds_of_a_setting_together(tmp_path: Path) -> None:
    """And its rows are kept: drawn again, they need no GPU."""
    words = "ablate benchmark --budget smoke --seeds 0 1 --datasets".split()
    words += ["marl_mm/gate/expert-v0", "--settings", "benchmark-bc", "--runs"]
    words += [str(tmp_path / "runs"), "--out", str(tmp_path / "out")]
    assert main([*words, "--device", "cuda"]) == 0
    shutil.rmtree(tmp_path / "runs")
    assert main([*words, "--overwrite"]) == 0
    assert not (tmp_path / "runs").exists()
