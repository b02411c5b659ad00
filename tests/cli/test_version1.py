"""Files that version 1 wrote still load, go on as they did, and evaluate."""

import json
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch.nn.functional import linear

from marl_mm.algorithms.checkpoint import FILE, read_checkpoint
from marl_mm.algorithms.policy import load_policy
from marl_mm.algorithms.pretrained import FOLDER, WEIGHTS, load_pretrained
from marl_mm.cli import main
from marl_mm.collectors.replay import replay
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.location import locate
from marl_mm.datasets.metadata import read_metadata
from marl_mm.datasets.storage import read_arrays
from marl_mm.datasets.verify import verify
from marl_mm.envs.tasks import grasp, reach

MADE = Path(__file__).parents[1] / "fixtures" / "version1.tar.xz"
"""Datasets, runs (offline after 200 updates, online after 4 episodes) and what the runs
were like when they had gone on (210 updates, 6 episodes); see further/."""


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Copies: reading a dataset leaves a cache beside it, going on changes a run."""
    with tarfile.open(MADE) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # 3.11.4
        archive.extractall(tmp_path)
    return tmp_path / "version1"


@pytest.mark.parametrize(
    ("name", "layout"), [("mix", reach.LAYOUT), ("grasp", grasp.LAYOUT)]
)
def test_datasets_load_with_the_layout_of_their_entries(
    files: Path, name: str, layout: object
) -> None:
    dataset = load_dataset(files / name)
    assert dataset.arrays.layout == layout and dataset.episodes[0].layout == layout
    assert dataset.metadata["marl_mm"]["schema"] == 2
    assert verify(dataset.location) == []
    assert {origin.task for origin in dataset.provenance.origins.values()} == {
        dataset.provenance.task
    }


def test_a_dataset_of_version_1_is_mixed_and_filtered(files: Path) -> None:
    out = str(files / "reached")
    assert main(["datasets", "filter", str(files / "mix"), "--out", out,
                 "--outcome", "reached"]) == 0  # fmt: skip
    made = load_dataset(locate(out))
    assert made.arrays.layout == reach.LAYOUT and made.arrays.successes().all()
    assert made.metadata["marl_mm"]["schema"] == 3


@pytest.mark.slow
def test_the_shipped_data_replay_to_the_bit(datasets_home: Path) -> None:
    """Some of them; ``datasets verify good-5k --replay`` does all."""
    whole = load_dataset("good-5k")
    some = Dataset(
        whole.location, whole.metadata, whole.arrays.select(range(0, 504, 63))
    )
    assert list(replay(some)) == [None] * 8


def _flat(state: Any, path: str = "") -> dict[str, Any]:
    if isinstance(state, Mapping):
        parts = [(f"{path}/{key}", value) for key, value in state.items()]
    elif isinstance(state, list | tuple):
        parts = [(f"{path}/{number}", value) for number, value in enumerate(state)]
    else:
        return {path: state}
    return {key: value for at, part in parts for key, value in _flat(part, at).items()}


@pytest.fixture
def products_of_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    """The runs' precision, ``medium``, is bfloat16 on some processors."""
    monkeypatch.setattr(torch, "set_float32_matmul_precision", lambda precision: None)


def assert_same(run: Path, algorithm: str) -> None:
    """It went on as with version 1: batches, counts and generators to the bit.

    Numbers that came of products have the last digits of the processor: on that of the
    fixture they were equal to the bit, but for lengths that version 1 let BLAS sum.
    Adam's settings, which version 1 had in its state, are the config's.
    """
    further = run.parents[1] / "further"
    before = read_checkpoint(further / algorithm / FILE, algorithm)
    gone_on = read_checkpoint(run / "0", algorithm)
    assert gone_on["layout"] == before["layout"] == reach.LAYOUT
    here, there = _flat(gone_on["state"]), _flat(before["state"])
    there = {k: value for k, value in there.items() if "/param_groups/" not in k}
    assert here.keys() == there.keys()
    for key, value in here.items():
        if isinstance(value, torch.Tensor):  # updates move weights by 5e-3
            assert torch.allclose(value, there[key], rtol=1e-3, atol=1e-5), key
        else:
            assert value == there[key], key


@pytest.mark.slow
@pytest.mark.bullet
@pytest.mark.usefixtures("products_of_float32")
@pytest.mark.parametrize("algorithm", ["mabc", "td3-bc", "matd3-bc"])
def test_offline_runs_go_on_as_they_did(files: Path, algorithm: str) -> None:
    run = files / "runs" / algorithm
    words = ["train", algorithm, "--out", str(run), "--resume", "--workers", "1"]
    words += ["--dataset", str(files / "mix"), "--updates", "210"]
    assert main([*words, "--eval-episodes", "2"]) == 0
    assert_same(run, algorithm)


@pytest.mark.slow
@pytest.mark.bullet
def test_an_online_run_goes_on_as_it_did(files: Path) -> None:
    run = files / "runs" / "maddpg-her"
    words = ["train", "maddpg-her", "--out", str(run), "--resume", "--workers", "1"]
    assert main([*words, "--episodes", "6"]) == 0
    assert_same(run, "maddpg-her")


@pytest.mark.bullet
@pytest.mark.parametrize("name", ["mabc", "td3-bc", "matd3-bc", "maddpg-her", "grasp"])
def test_runs_act_and_evaluate(
    files: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    run = files / "runs" / name / "0"
    layout = grasp.LAYOUT if name == "grasp" else reach.LAYOUT
    assert load_policy(run).layout == layout
    words = ["eval", str(run), "--episodes", "2", "--max-steps", "2", "--json"]
    assert main([*words, "--workers", "1"]) == 0
    (evaluation,) = json.loads(capsys.readouterr().out)
    assert len(evaluation["episodes"]) == 2


def test_the_shipped_agent_acts_as_it_did(files: Path) -> None:
    """On 1,000 states of its own data: to the bit what version 1 computed, and to the
    last digits, which are the processor's, what it computed on another machine."""
    stored = np.load(files / "shipped_actions.npz")
    policy = load_pretrained()
    actions = np.array([policy.act(state) for state in stored["states"]])
    assert actions.dtype == stored["actions"].dtype
    computed = np.array([_version1_action(state) for state in stored["states"]])
    assert actions.tobytes() == computed.tobytes()
    np.testing.assert_allclose(actions, stored["actions"], atol=2e-6)


@torch.no_grad()
def _version1_action(state: np.ndarray) -> np.ndarray:
    """What it did in version 1, operation by operation."""
    file = load_file(FOLDER / WEIGHTS)
    # Copies, as the file's values are not aligned, by which some products differ.
    joint = {name.removeprefix("joint/"): value.clone() for name, value in file.items()}
    low, high = torch.tensor([-1.0, -1.0, -1.0, 0.0]), torch.ones(4)
    seen = torch.as_tensor(state, dtype=torch.float32)
    unit = (seen - joint["normalizer.mean"]) / joint["normalizer.std"]
    for layer in (0, 2, 4):
        unit = linear(
            unit, joint[f"layers.{layer}.weight"], joint[f"layers.{layer}.bias"]
        )
        unit = torch.relu(unit) if layer < 4 else torch.tanh(unit)
    action: np.ndarray = (low + (unit + 1) / 2 * (high - low)).numpy()
    return action


def test_layouts_that_version_1_had_not_are_refused(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = files / "runs/mabc/0" / FILE
    checkpoint = torch.load(path, weights_only=True)
    checkpoint["layout"]["agents"][1][1] = [0, 1]
    torch.save(checkpoint, path)
    assert main(["eval", str(path.parent), "--episodes", "2"]) == 1
    assert "no layout of version 1" in capsys.readouterr().err
    location = locate(str(files / "mix"))
    metadata = read_metadata(location)
    metadata["marl_mm"]["state"] = metadata["marl_mm"]["state"][::-1]
    with pytest.raises(
        Exception, match="no layout of version 1 has the entries goal_z"
    ):
        read_arrays(location, metadata, cached=False)
