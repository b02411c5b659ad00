"""The small dataset of MuJoCo that ships with the tests: replayed, made again, learnt.

``marl-mm collect pd --alpha-rule room --steps 60 --engine mujoco --dataset
marl_mm/reach/mujoco-60-v0`` makes it anew; the folder, without card.md and card.png,
is the archive's.
"""

import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import marl_mm
from marl_mm.cli import main
from marl_mm.collectors.replay import problems
from marl_mm.datasets.dataset import Dataset, load_dataset
from marl_mm.datasets.storage import write_dataset
from marl_mm.datasets.verify import verify
from marl_mm.envs import rollout

MADE = Path(__file__).parents[1] / "fixtures" / "mujoco-60.tar.xz"


@pytest.fixture
def shipped(datasets_home: Path, tmp_path: Path) -> Dataset:
    with tarfile.open(MADE) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # 3.11.4
        archive.extractall(tmp_path)
    return load_dataset(tmp_path / "mujoco-60")


def test_it_is_small_and_whole_and_names_its_engine(shipped: Dataset) -> None:
    assert MADE.stat().st_size < 60_000
    assert verify(shipped.location) == []
    assert shipped.arrays.steps >= 60 and shipped.arrays.successes().all()
    assert shipped.card()["engine"] == "mujoco 4.0.0"
    assert shipped.provenance.engine == "mujoco"


def test_it_replays_to_the_last_bit(
    shipped: Dataset, capsys: pytest.CaptureFixture[str]
) -> None:
    name = str(shipped.location.folder)
    assert main(["datasets", "verify", name, "--replay", "--workers", "1"]) == 0
    assert "all is well" in capsys.readouterr().out
    info = shipped.arrays.info
    wider = info | {"qp_failures": info["qp_failures"].astype(float)}  # as of a mix
    arrays = replace(shipped.arrays, info=wider)
    write_dataset(shipped.location, arrays, shipped.provenance, overwrite=True)
    assert problems(load_dataset(name)) == []
    wider["qp_failures"][3] = 0.5
    write_dataset(shipped.location, arrays, shipped.provenance, overwrite=True)
    (problem,) = problems(load_dataset(name))
    assert "qp_failures is int64 in the replay, float64 in the file" in problem


@pytest.mark.slow
@pytest.mark.parametrize(("workers", "threads"), [(1, True), (2, True), (2, False)])
def test_it_is_collected_again_to_the_last_bit(
    shipped: Dataset, workers: int, threads: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By one worker, by two threads and by two processes."""
    if not threads:
        monkeypatch.setattr(rollout, "threads_serve", lambda *given: False)
    made = marl_mm.collect(
        "pd",
        dataset="marl_mm/reach/mujoco-60-v0",
        alpha_rule="room",
        steps=60,
        engine="mujoco",
        workers=workers,
    )
    for name in ("states", "actions", "rewards", "lengths"):
        again, before = (getattr(one.arrays, name) for one in (made, shipped))
        assert again.tobytes() == before.tobytes(), name
    assert made.arrays.info.keys() == shipped.arrays.info.keys()
    for name, values in shipped.arrays.info.items():
        assert made.arrays.info[name].tobytes() == values.tobytes(), name


@pytest.mark.slow
def test_agents_learn_from_it(shipped: Dataset, tmp_path: Path) -> None:
    few: dict[str, Any] = {
        "updates": 20,
        "hidden": (8,),
        "eval_episodes": 2,
        "curve_episodes": 1,
    }
    (run,) = marl_mm.train("mabc", shipped, out=tmp_path / "run", **few)
    assert run.config.engine == "mujoco"
    evaluation = run.evaluated.to_json()
    assert (evaluation["engine"], evaluation["engine_version"]) == ("mujoco", "4.0.0")
