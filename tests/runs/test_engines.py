"""The engine stands in every dataset, run and evaluation, and is not mixed."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

import marl_mm
from marl_mm.cli import main
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.metadata import sign_metadata
from marl_mm.errors import CheckpointError, UsageError

FEW: dict[str, Any] = {
    "eval_episodes": 2,
    "curve_episodes": 1,
    "hidden": (8,),
    "max_steps": 3,
}


def run(*words: object) -> int:
    try:
        return main([str(word) for word in words])
    except SystemExit as end:
        return int(end.code or 0)


@pytest.fixture
def fallen(datasets_home: Path) -> Any:
    """A small dataset of MuJoCo."""
    return marl_mm.collect("pd", dataset="fallen", steps=60, engine="mujoco")


@pytest.mark.slow
def test_a_dataset_names_its_engine_and_replays(
    fallen: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    record = fallen.provenance
    assert record.config["simulation"]["engine"] == "mujoco"
    assert "mujoco-core" in record.packages
    assert run("datasets", "verify", "fallen", "--replay") == 0
    with_two = marl_mm.collect(
        "pd", dataset="two", steps=60, engine="mujoco", workers=2
    )
    assert with_two.fingerprint == fallen.fingerprint
    assert run("collect", "pd", "--dataset", "fallen", "--steps", 90, "--resume") == 0
    assert load_dataset("fallen").provenance.overrides["simulation"] == {
        "engine": "mujoco"
    }
    other = "--resume", "--engine", "bullet", "--steps", 120
    assert run("collect", "pd", "--dataset", "fallen", *other) == 2
    assert "engine = mujoco (now bullet)" in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_is_evaluated_on_the_engine_of_its_data(
    fallen: Any, tmp_path: Path
) -> None:
    (first,) = marl_mm.train("td3-bc", fallen, out=tmp_path / "a", updates=20, **FEW)
    assert first.config.engine == "mujoco"
    assert first.evaluated.to_json()["engine"] == "mujoco"
    assert marl_mm.evaluate(first, episodes=2).to_json()["engine"] == "mujoco"
    other = marl_mm.evaluate(first, episodes=2, engine="bullet")
    assert other.to_json()["engine"] == "bullet"
    assert "film strip" in first._repr_html_()
    (second,) = marl_mm.train(
        "td3-bc", "good-5k", out=tmp_path / "b", updates=20, **FEW
    )
    assert second.config.engine == "bullet"
    both = first.folder, second.folder
    assert run("eval", *both, "--episodes", 2) == 2  # their engines differ
    assert run("eval", *both, "--episodes", 2, "--engine", "mujoco") == 0


@pytest.mark.slow
def test_datasets_of_two_engines_are_not_mixed(
    fallen: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    parts = "good-5k:60", "fallen:60"
    assert run("datasets", "mix", *parts, "--out", "mixed") == 2
    assert "of engines bullet and mujoco" in capsys.readouterr().err
    with pytest.raises(UsageError, match="is of engine mujoco, expected bullet"):
        marl_mm.train("ddpg-her", demonstrations="fallen", engine="bullet")


@pytest.mark.slow
def test_what_version_1_began_goes_on(datasets_home: Path, tmp_path: Path) -> None:
    """It names no engine."""
    marl_mm.collect("pd", dataset="old", steps=30)
    file = load_dataset("old").location.folder / "data/metadata.json"
    metadata = json.loads(file.read_text())
    for about in (metadata["marl_mm"], *metadata["marl_mm"]["origins"].values()):
        assert about["config"]["simulation"].pop("engine") == "bullet"
    file.write_text(json.dumps(metadata))
    sign_metadata(file)
    marl_mm.collect("pd", dataset="old", steps=60, resume=True)
    (first,) = marl_mm.train("td3-bc", "good-5k", out=tmp_path, updates=20, **FEW)
    config = json.loads((first.folder / "config.json").read_text())
    (first.folder / "config.json").write_text(json.dumps(config | {"updates": "x"}))
    with pytest.raises(CheckpointError, match="updates is 'x'"):
        marl_mm.train("td3-bc", "good-5k", out=tmp_path, resume=True)
    assert config.pop("engine") == "bullet"
    (first.folder / "config.json").write_text(json.dumps(config))
    marl_mm.train("td3-bc", "good-5k", out=tmp_path, updates=40, resume=True, **FEW)


WITHOUT_BULLET = """
import json, sys
sys.modules["pybullet"] = None
from marl_mm.cli import main
for words in json.load(sys.stdin):
    code = main(words)
    for stream in (sys.stdout, sys.stderr):
        print(f"|{code}|", file=stream, flush=True)
"""


def without_bullet(*commands: Sequence[object]) -> Iterator[tuple[int, str, str]]:
    """Exit code, stdout and stderr of commands where PyBullet is not installed."""
    ended = subprocess.run(
        [sys.executable, "-c", WITHOUT_BULLET],
        input=json.dumps([[*map(str, words)] for words in commands]),
        capture_output=True,
        text=True,
        check=True,
    )
    output, complaints = (
        re.split(r"\|(\d+)\|\n", stream) for stream in (ended.stdout, ended.stderr)
    )
    return zip(map(int, output[1::2]), output[::2], complaints[::2], strict=False)


@pytest.mark.slow
def test_mujoco_takes_the_place_of_pybullet_and_says_so_once(
    datasets_home: Path, tmp_path: Path
) -> None:
    runs = "--out", tmp_path, "--updates", 20, "--eval-episodes", 2, "--workers", 1
    ended = without_bullet(
        ("collect", "pd", "--steps", 30, "--workers", 1),
        ("eval", "pd", "--episodes", 2, "--workers", 1, "--json"),
        ("train", "mabc", "--dataset", "pd", *runs, "--curve-episodes", 1),
        ("datasets", "verify", "pd", "--replay"),
    )
    codes, output, complaints = zip(*ended, strict=True)
    assert codes == (0, 0, 0, 0), complaints
    assert "".join(complaints).count("PyBullet is not installed") == 1
    data = load_dataset("pd")
    assert data.provenance.overrides["simulation"] == {"engine": "mujoco"}
    (result,) = json.loads(output[1])
    assert result["engine"] == "mujoco"
    assert json.loads((tmp_path / "0/config.json").read_text())["engine"] == "mujoco"


@pytest.mark.slow
def test_what_needs_pybullet_says_so_in_one_line(
    datasets_home: Path, tmp_path: Path
) -> None:
    load_dataset("good-5k")
    verify = "datasets", "verify", "good-5k"
    film = "play", "pd", "--video", tmp_path / "film.mp4"
    train = "train", "mabc", "--dataset", "good-5k", "--out", tmp_path / "runs"
    asked = (*verify, "--replay"), film, train
    (whole, *_), *refused = without_bullet(verify, *asked)
    assert whole == 0
    for words, (code, _, complaint) in zip(asked, refused, strict=True):
        assert code == 2, complaint
        *rest, line = complaint.splitlines()
        assert all("MuJoCo simulates" in words for words in rest), rest  # and no bar
        assert line.startswith("marl-mm: "), line
        assert "pip install pybullet" in line
        # ``verify`` and ``play`` have no such option, or no other engine to name.
        assert ("--engine" in line) == ("train" in words), line
    assert not (tmp_path / "runs").exists()
