"""Several seeds in one command: in processes, stopped, resumed."""

import json
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import torch

import marl_mm
from marl_mm.algorithms.checkpoint import FILE, read_checkpoint
from marl_mm.algorithms.policy import load_policy
from marl_mm.cli import main
from marl_mm.datasets.arrays import arrays_of
from marl_mm.datasets.location import locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.storage import write_dataset
from marl_mm.episode import Episode
from marl_mm.errors import OutputExistsError
from marl_mm.runs import seeds as seeding
from marl_mm.runs.checks import check_training
from marl_mm.runs.folder import CONFIG
from marl_mm.runs.run import Run
from marl_mm.runs.training import Offline
from tests.forks import Fork
from tests.runs.tampering import edit

WorkersOf = Callable[[int], list[psutil.Process]]
MakeEpisode = Callable[..., Episode]

SMALL = (
    "td3-bc --dataset good-5k --updates 300 --hidden 8 8 --batch-size 16 "
    "--curve-every 200 --curve-episodes 1 --eval-episodes 2 --max-steps 5 "
    "--engine mujoco"
).split()
KEPT = ("metrics.jsonl", FILE)


def evaluated(run: Path) -> object:
    return json.loads((run / "eval.json").read_text())["episodes"]


def wait_for(path: Path, job: Fork) -> None:
    end = time.monotonic() + 120
    while not path.exists():
        time.sleep(0.05)
        assert job.running() and time.monotonic() < end


@pytest.fixture(scope="module", autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Where the dataset that ships is unpacked."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("datasets")
        patch.setenv("MINARI_DATASETS_PATH", str(folder))
        yield


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seeds one after the other in this process."""
    out = tmp_path_factory.mktemp("runs") / "alone"
    seeds = ["--seeds", "0", "1", "2", "--workers", "1", "--out", str(out)]
    assert main(["train", *SMALL, *seeds]) == 0
    return out


@pytest.mark.slow
def test_interrupted_processes_go_on_to_the_same_end(
    alone: Path, tmp_path: Path
) -> None:
    """As seeds one after the other do: a real Ctrl-C, then ``--resume``, no more."""
    out = ["--out", str(tmp_path), "--workers", "2"]
    words = ["train", *SMALL, "--seeds", "0", "1", "2", *out]
    with Fork(*words) as job:
        wait_for(tmp_path / "0" / FILE, job)
        os.kill(job.pid, signal.SIGINT)
        assert job.wait() == 130
        assert job.complaint.strip().endswith("go on with --resume")
    assert not (tmp_path / "2" / "eval.json").exists()
    assert main(["train", "td3-bc", "--resume", "--eval-episodes", "2", *out]) == 0
    for seed in "012":
        for name in KEPT:
            one, other = tmp_path / seed / name, alone / seed / name
            assert one.read_bytes() == other.read_bytes()
        assert evaluated(tmp_path / seed) == evaluated(alone / seed)


@pytest.mark.slow
def test_more_updates_go_on_as_if_they_had_been_asked_for_at_once(
    alone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "runs"), "--workers", "1"]
    short = [word if word != "300" else "100" for word in SMALL]
    assert main(["train", *short, *out]) == 0
    further = ["train", "td3-bc", "--preset", "tuned", *out, "--resume", "--updates"]
    assert main([*further, "300", "--eval-episodes", "2"]) == 0
    run = tmp_path / "runs" / "0"
    assert (run / FILE).read_bytes() == (alone / "0" / FILE).read_bytes()
    assert evaluated(run) == evaluated(alone / "0")
    assert json.loads((run / "config.json").read_text())["updates"] == 300
    assert main([*further, "200"]) == 2
    assert "has 300 updates already" in capsys.readouterr().err
    falling = [*short, "--q-weight-end", "0.1", *out, "--overwrite"]
    assert main(["train", *falling]) == 0
    assert main([*further, "200"]) == 2
    assert "--q-weight-end with it" in capsys.readouterr().err


@pytest.mark.slow
def test_a_killed_process_ends_the_command_and_leaves_checkpoints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], workers_of: WorkersOf
) -> None:
    out = ["--out", str(tmp_path), "--seeds", "0", "1", "--workers", "2"]
    long = [word if word != "300" else "1000000" for word in SMALL]
    with Fork("train", *long, *out) as job:
        for seed in "01":
            wait_for(tmp_path / seed / FILE, job)
        assert main(["train", *long, *out, "--overwrite"]) == 2
        assert "another process is writing" in capsys.readouterr().err
        learners = workers_of(job.pid)
        learners[0].kill()
        assert job.wait() == 1
        complaint = job.complaint
    assert "a worker process died" in complaint
    assert complaint.strip().endswith("go on with --resume")
    _, alive = psutil.wait_procs(learners, timeout=10)
    assert not alive
    for seed in "01":
        assert np.isfinite(load_policy(tmp_path / seed).act(np.zeros(10))).all()


@pytest.mark.slow
@pytest.mark.bullet
def test_a_folder_left_empty_by_an_interrupt_is_no_run(tmp_path: Path) -> None:
    (tmp_path / "0").mkdir()
    assert main(["train", *SMALL, "--updates", "1", "--out", str(tmp_path)]) == 0


@pytest.mark.slow
def test_seeds_that_diverge_keep_their_last_checkpoints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """c grows until the mean loss is infinite, after the first checkpoint."""
    seeds = ["--seeds", "0", "1", "--workers", "2", "--out", str(tmp_path)]
    assert main(["train", *SMALL, "--q-weight-end", "2e37", *seeds]) == 1
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("marl-mm: loss/actor is ")
    for seed in "01":  # one that fails does not stop the other
        assert f"{tmp_path}/{seed}: the checkpoint of update 100" in last
        assert read_checkpoint(tmp_path / seed)["state"]["step"] == 100
        assert np.isfinite(load_policy(tmp_path / seed).act(np.zeros(10))).all()


def test_a_dataset_without_successes_is_refused(
    make_episode: MakeEpisode, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failures = [make_episode(i, steps=9, success=False) for i in range(3)]
    location = locate(str(tmp_path / "failures"))
    provenance = Provenance(task="Reach-v0", collector="pd")
    write_dataset(location, arrays_of(failures, "x"), provenance)
    words = [*SMALL, "--out", str(tmp_path / "run"), "--dataset", str(location.folder)]
    assert main(["train", *words]) == 1
    said = capsys.readouterr().err
    assert "none of the 3 episodes of" in said
    assert "--no-require-success" in said
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_run_of_a_dataset_without_successes_goes_on(
    make_episode: MakeEpisode, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without being told again; on another dataset it does not."""
    for name, count in (("failures", 3), ("others", 4)):
        failures = [make_episode(i, steps=9, success=False) for i in range(count)]
        provenance = Provenance(task="Reach-v0", collector="pd")
        location = locate(str(tmp_path / name))
        write_dataset(location, arrays_of(failures, "x"), provenance)
    out = ["--out", str(tmp_path / "runs")]
    short = [word if word != "300" else "100" for word in SMALL]
    own = ["--dataset", str(tmp_path / "failures"), "--no-require-success"]
    assert main(["train", *short, *own, "--imitate", "all", *out]) == 0
    assert main(["export", str(tmp_path / "runs/0")]) == 0
    own_files = [tmp_path / "runs/0" / name for name in ("mine.ts", "eval_mine.json")]
    for file in own_files:
        file.write_text("a user's")
    further = ["train", "td3-bc", *out, "--resume", "--updates", "200"]
    other = ["--dataset", str(tmp_path / "others")]
    capsys.readouterr()
    assert main([*further, *other]) == 2
    assert "was made with dataset." in capsys.readouterr().err
    assert (tmp_path / "runs/0/policy.ts").exists()
    assert main(further) == 0
    assert read_checkpoint(tmp_path / "runs/0")["state"]["step"] == 200
    assert not (tmp_path / "runs/0/policy.ts").exists()  # it was of 100 updates
    anew = ["train", *short, *own, "--imitate", "all", *out, "--overwrite"]
    assert main(anew) == 0
    assert {file.read_text() for file in own_files} == {"a user's"}


def test_a_run_in_the_place_of_its_folder_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "runs" / "3"
    run.mkdir(parents=True)
    (run / "config.json").write_text("{}")
    assert main(["train", "ddpg-her", "--out", str(run), "--resume"]) == 2
    asked = f"--out {run.parent} --seeds 3"
    assert asked in capsys.readouterr().err


def test_online_learners_take_no_dataset(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "ddpg-her", "--dataset", "good-5k"]) == 2
    said = capsys.readouterr().err
    assert "--demonstrations" in said and said.count("\n") == 1


def test_a_missing_gpu_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    words = [*SMALL, "--device", "cuda", "--out", str(tmp_path / "run")]
    assert main(["train", *words]) == 2
    assert "torch finds no such GPU" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    assert main(["ablate", "benchmark", "--plan", "--device", "cuda"]) == 2
    assert "torch finds no such GPU" in capsys.readouterr().err


@pytest.mark.parametrize("study", ["tuning", "engines"])
def test_studies_that_use_no_gpu_refuse_it(
    study: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ablate", study, "--plan", "--device", "cuda"]) == 2
    assert "--device is cuda, expected cpu" in capsys.readouterr().err


FEW: dict[str, Any] = {
    **{"updates": 20, "hidden": (8, 8), "batch_size": 16, "engine": "mujoco"},
    **{"curve_every": 100, "curve_episodes": 1, "eval_episodes": 1, "max_steps": 3},
}


def trained(out: Path, **settings: Any) -> list[Run]:
    return marl_mm.train("td3-bc", "good-5k", out=out, **FEW | settings)


@pytest.mark.slow
def test_seeds_at_several_updates_go_on_side_by_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed, updates in enumerate((20, 10)):
        trained(tmp_path, seeds=(seed,), updates=updates)
    monkeypatch.setattr(Offline, "side_by_side", True)
    runs = trained(tmp_path, seeds=(0, 1), updates=30, resume=True)
    assert [run.metrics[-1]["step"] for run in runs] == [30, 30]


@pytest.mark.slow
def test_a_run_that_another_process_made_meanwhile_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (other,) = trained(tmp_path / "other")

    def beside_another(*given: Any) -> None:
        check_training(*given)
        shutil.copytree(other.folder, tmp_path / "out/0", dirs_exist_ok=True)

    monkeypatch.setattr(seeding, "check_training", beside_another)
    with pytest.raises(OutputExistsError):
        trained(tmp_path / "out", updates=5)
    for path in other.folder.iterdir():
        assert (tmp_path / "out/0" / path.name).read_bytes() == path.read_bytes()


@pytest.mark.slow
def test_what_is_not_the_runs_stays_where_it_is_overwritten(tmp_path: Path) -> None:
    """Such as an evaluation that ``marl-mm eval --out`` wrote there."""
    (run,) = trained(tmp_path)
    names = "eval_mine.json", "eval_best.json", "best.zip"
    mine, *older = (run.folder / name for name in names)
    for path in (mine, *older):
        path.write_text("{}")
    trained(tmp_path, updates=5, overwrite=True)
    assert mine.exists() and not any(path.exists() for path in older)


@pytest.mark.slow
def test_a_run_goes_on_where_its_dataset_has_moved(tmp_path: Path) -> None:
    (run,) = trained(tmp_path)
    edit(run.folder / CONFIG, lambda v: v["dataset"].update(path="/elsewhere"))
    (more,) = trained(tmp_path, updates=30, resume=True)
    assert more.metrics[-1]["step"] == 30
