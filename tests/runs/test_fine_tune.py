"""Offline to online: runs from a dataset that go on with episodes of their own."""

import hashlib
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from shutil import copyfile
from typing import Any

import numpy as np
import pytest
import torch

import marl_mm
from marl_mm.algorithms.checkpoint import BEST, FILE, read_checkpoint
from marl_mm.algorithms.explore import Explorer
from marl_mm.algorithms.fine_tune import fine_tune, online_summary
from marl_mm.algorithms.fine_tuning import FineTuning
from marl_mm.algorithms.mabc import Mabc
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.matd3_bc import Matd3Bc
from marl_mm.algorithms.offline_batches import OfflineBatches
from marl_mm.algorithms.offline_learner import OfflineLearner
from marl_mm.algorithms.runlog import METRICS, read_metrics
from marl_mm.algorithms.td3_bc_additions import q_weight
from marl_mm.algorithms.td3_bc_config import Td3BcConfig
from marl_mm.cli import main
from marl_mm.contracts.learners import some_episodes
from marl_mm.envs.registry import make_task
from marl_mm.envs.rollout import Rollouts
from marl_mm.episode import Episode
from marl_mm.errors import (
    CheckpointError,
    DivergedError,
    OtherConfigError,
    UsageError,
)
from marl_mm.eval.rows import read_rows
from marl_mm.files import only_here
from marl_mm.runs import learning
from marl_mm.runs.folder import CONFIG
from marl_mm.runs.run import Run
from marl_mm.runs.starts import copy_start, start_hash
from marl_mm.runs.submission import OF_A_SEED
from marl_mm.runs.train import repeat
from marl_mm.sim.world import check_engine
from tests.algorithms.games import NoJudge
from tests.runs.tampering import edit

SMALL: dict[str, Any] = {
    **{"updates": 100, "hidden": (8, 8), "batch_size": 16, "engine": "mujoco"},
    **{"curve_every": 100, "curve_episodes": 1, "eval_episodes": 1, "max_steps": 5},
    **{"precision": "highest", "logger": ()},
}
OWN: dict[str, Any] = {"online_every": 20, "online_cycle": 2}
KEPT = (FILE, METRICS)


def trained(name: str, out: Path, **settings: Any) -> Run:
    own = OWN if settings.get("online_steps") else {}
    (run,) = marl_mm.train(name, "good-5k", out=out, **SMALL | own | settings)
    return run


def same(one: Path, other: Path) -> bool:
    return all((one / f).read_bytes() == (other / f).read_bytes() for f in KEPT)


@pytest.fixture(scope="module", autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Where the dataset that ships is unpacked."""
    check_engine("mujoco")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path_factory.mktemp("datasets")))
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A hundred updates and at least sixty own steps, in one go."""
    return trained("matd3-bc", tmp_path_factory.mktemp("whole"), online_steps=60)


# --- Runs --------------------------------------------------------------------


def test_rows_go_on_with_env_steps_and_how_the_run_fares(whole: Run) -> None:
    rows = read_metrics(whole.folder)
    begun = [row for row in rows if row.get("env_steps") == 0]
    online = [row for row in rows if row.get("env_steps")]
    assert len(begun) == 1 and begun[0]["step"] == 100
    assert [row["env_steps"] // 20 for row in online] == [1, 2, 3]
    for row in online:
        assert row["step"] == 100 + row["env_steps"]
        assert row["online/kept"] == 0.5 and "online/regret" in row
        assert "loss/critic" in row and "train/success" in row
    own = read_checkpoint(whole.folder)["state"]["batches"]["own"]
    assert len(own["reward"]) == online[-1]["env_steps"]


@pytest.mark.slow
@pytest.mark.parametrize("when", ["before", "in", "after"])
def test_a_run_that_is_stopped_goes_on_to_the_same_end(
    whole: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    """To the bit: stopped before its first own episode, in the second, later."""
    left, run = {"before": 0, "in": 1, "after": 9}[when], Rollouts.train

    def interrupted(self: Rollouts, seed: int, policy: Any, numbers: range) -> Any:
        for episode in run(self, seed, policy, numbers):
            nonlocal left
            if left == 0:
                raise KeyboardInterrupt
            left -= 1
            yield episode

    with monkeypatch.context() as patch:
        patch.setattr(Rollouts, "train", interrupted)
        with pytest.raises(KeyboardInterrupt, match="go on with `resume=True`"):
            trained("matd3-bc", tmp_path, online_steps=60)
    assert not same(tmp_path / "0", whole.folder)
    trained("matd3-bc", tmp_path, online_steps=60, resume=True)
    assert same(tmp_path / "0", whole.folder)


@pytest.mark.slow
def test_a_run_started_from_another_is_as_if_it_were_one(
    whole: Run, tmp_path: Path
) -> None:
    first = trained("matd3-bc", tmp_path / "offline")
    before = (first.folder / FILE).read_bytes()
    for start in (first.folder, first.folder.parent):
        out = tmp_path / f"from-{start.name}"
        marl_mm.train("matd3-bc", out=out, start=start, online_steps=60, **online())
        assert same(out / "0", whole.folder)
    assert (first.folder / FILE).read_bytes() == before


def online() -> dict[str, Any]:
    """What a run that starts from another does not take from it."""
    return OWN | {"logger": ()}


@pytest.mark.slow
def test_more_own_steps_are_gone_on_to(whole: Run, tmp_path: Path) -> None:
    trained("matd3-bc", tmp_path, online_steps=40)
    trained("matd3-bc", tmp_path, online_steps=60, resume=True)
    assert same(tmp_path / "0", whole.folder)


@pytest.mark.slow
def test_workers_do_not_count(whole: Run, tmp_path: Path) -> None:
    trained("matd3-bc", tmp_path, online_steps=60, workers=2)
    assert same(tmp_path / "0", whole.folder)


@pytest.mark.parametrize("name", ["rlpd", "ma-cal-ql", "q-chunking", "ma-flow-bc"])
def test_every_kind_of_actor_goes_on(name: str, tmp_path: Path) -> None:
    """Of RLPD without an update before: it learns from its first episode on."""
    none = {"updates": 0} if name == "rlpd" else {}
    run = trained(name, tmp_path, online_steps=20, updates_per_step=2, **none)
    last = read_metrics(run.folder)[-1]
    assert last["step"] == none.get("updates", 100) + 2 * last["env_steps"]
    assert run.evaluated is not None


def test_cycles_may_be_of_a_single_update(tmp_path: Path) -> None:
    """Of which every second leaves the actors alone; their losses are of the others."""
    one = {"max_steps": 1, "online_cycle": 1, "online_every": 5}
    run = trained("matd3-bc", tmp_path, online_steps=5, updates=101, **one)
    last = read_metrics(run.folder)[-1]
    assert last["step"] == 106 and np.isfinite(last["loss/end_effector"])


# --- What is refused ---------------------------------------------------------


def test_what_cannot_go_on_is_refused_before_any_work(
    whole: Run, tmp_path: Path
) -> None:
    def refused(words: str, name: str = "matd3-bc", **settings: Any) -> None:
        with pytest.raises((UsageError, OtherConfigError), match=words):
            trained(name, tmp_path / "new", **{"online_steps": 20} | settings)
        assert not (tmp_path / "new").exists()

    refused("nowhere', and there is no run", start=tmp_path / "nowhere")
    refused("is a run of matd3-bc, expected td3-bc", "td3-bc", start=whole.folder)
    refused("has gone on online already", start=whole.folder)
    refused("kept is 1.5, expected 0 to 1", kept=1.5)
    refused("online_noise is nan", online_noise=float("nan"))
    refused("online_steps is 1000000000000, expected at most", online_steps=10**12)
    refused("is of Reach-v0, expected PreciseReach-v0", task="PreciseReach-v0")
    refused("online_every is 0, expected > 0", online_every=0)
    refused("`kept` is 0.9, but `online_steps` is 0", online_steps=0, kept=0.9)
    refused("`updates` is 0 and `online_steps` too", "rlpd", updates=0, online_steps=0)


def test_a_start_is_locked_while_it_is_copied(
    offline: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who trains it meanwhile would leave rows of one time and weights of another."""
    copied: list[Path] = []

    def copy(start: Path, run: Path) -> None:
        with pytest.raises(UsageError, match="another process"), only_here(start):
            pass
        copied.append(start)
        copy_start(start, run)

    monkeypatch.setattr(learning, "copy_start", copy)
    more: dict[str, Any] = {"start": offline.folder, "online_steps": 20, **online()}
    marl_mm.train("matd3-bc", out=tmp_path, **more)
    assert copied == [offline.folder]
    recorded = start_hash(offline.folder).keys()
    assert {"start", *recorded} <= {*OF_A_SEED}  # other seeds have other starts
    with only_here(offline.folder):
        pass


@pytest.fixture(scope="module")
def offline(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A hundred updates and no more."""
    return trained("matd3-bc", tmp_path_factory.mktemp("offline"))


def test_what_a_run_cannot_start_from_is_refused_and_stays(
    offline: Run, tmp_path: Path
) -> None:
    """No folder is made; nothing of the start is touched, above all not overwritten."""
    out, start = offline.folder.parent, offline.folder

    def refused(words: str, **settings: Any) -> None:
        asked = {"out": tmp_path / "new", "start": start, "online_steps": 20}
        with pytest.raises((UsageError, OtherConfigError), match=words):
            marl_mm.train("matd3-bc", **online() | asked | settings)
        assert not (tmp_path / "new").exists()

    before = {path: path.read_bytes() for path in start.iterdir() if path.is_file()}
    refused("both .*: choose another `out`", out=out, overwrite=True)
    refused("was made with q_weight = 0.5, expected 1", q_weight=1.0)
    refused("was made with updates = 100, expected 50", updates=50)
    refused("is a single run, .* `seeds` are 2", seeds=(0, 1))
    with pytest.raises(UsageError, match="without own episodes: with `start`"):
        marl_mm.train("matd3-bc", out=out, resume=True, online_steps=20)
    other = marl_mm.collect("pd", dataset=tmp_path / "other", steps=30, engine="mujoco")
    refused("learnt from .*good-5k", dataset=other)
    assert before == {path: path.read_bytes() for path in before}


def test_a_start_with_a_link_out_or_of_another_plug_in_is_refused(
    offline: Run,
    tmp_path: Path,
) -> None:
    start, new = tmp_path / "start", tmp_path / "new"
    shutil.copytree(offline.folder, start)
    (start / METRICS).rename(tmp_path / METRICS)
    (start / METRICS).symlink_to(tmp_path / METRICS)
    asked = online() | {"out": new, "start": start, "online_steps": 20}
    with pytest.raises(CheckpointError, match="is a link out of its folder"):
        marl_mm.train("matd3-bc", **asked)
    edit(start / CONFIG, lambda v: v.update(plugins={"mine.py": "0" * 64}))
    with pytest.raises(OtherConfigError, match=r"with another mine\.py"):
        marl_mm.train("matd3-bc", **asked)
    assert not new.exists()


@pytest.mark.slow
def test_a_start_may_be_gone_once_the_run_has_its_own_checkpoint(
    offline: Run, whole: Run, tmp_path: Path
) -> None:
    shutil.copytree(offline.folder, tmp_path / "start")
    asked: dict[str, Any] = online() | {
        "out": tmp_path / "runs",
        "start": tmp_path / "start",
    }
    (run,) = marl_mm.train("matd3-bc", online_steps=40, **asked)
    began = hashlib.sha256((tmp_path / "start" / FILE).read_bytes()).hexdigest()
    assert run.config.settings["start_sha256"] == began
    (tmp_path / "start" / FILE).write_bytes(b"another")
    with pytest.raises(UsageError, match="is not the checkpoint that the run started"):
        repeat(run.config, out=tmp_path / "again")
    shutil.rmtree(tmp_path / "start")
    again: dict[str, Any] = {"resume": True, "out": tmp_path / "runs", "logger": ()}
    marl_mm.train("matd3-bc", online_steps=60, **again)
    assert same(tmp_path / "runs/0", whole.folder)
    with pytest.raises(
        UsageError, match=r"`online_steps` is 20, but .* was to take 60"
    ):
        marl_mm.train("matd3-bc", online_steps=20, **again)


def test_the_command_takes_the_start_in_either_way(
    offline: Run,
    whole: Run,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    words = ["train", "matd3-bc", "--online-steps", "60", "--online-every", "20"]
    words += ["--online-cycle", "2", "--out", str(tmp_path), "--workers", "1"]
    assert main([*words, f"--from={offline.folder}", "--logger", "csv"]) == 0
    assert same(tmp_path / "0", whole.folder)
    capsys.readouterr()
    again = ["train", "matd3-bc", f"--from={offline.folder}", "--resume"]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    shutil.copytree(tmp_path / "0", "runs/matd3-bc-online/0")
    assert main([*again, "--online-steps", "60", "--logger", "csv"]) == 0
    assert main([*words, "--from", "nowhere"]) == 2
    assert "--from is 'nowhere', and there is no run" in capsys.readouterr().err
    assert main([*again[:-1], "--out", "idle"]) == 2
    assert "--online-steps is 0: there is nothing to learn" in capsys.readouterr().err
    assert not Path("idle").exists()


def test_values_beyond_their_bounds_stop_a_run_online_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At its last checkpoint."""
    diagnose = Matd3Bc.diagnose

    def grown(self: Matd3Bc) -> dict[str, torch.Tensor]:
        far = {"q/largest": torch.tensor([1e9])} if self.own[1] else {}
        return diagnose(self) | far

    monkeypatch.setattr(Matd3Bc, "diagnose", grown)
    with pytest.raises(DivergedError, match=r"q/largest is 1e.09.*of env step 0"):
        trained("matd3-bc", tmp_path, online_steps=20)
    assert read_checkpoint(tmp_path / "0")["state"]["step"] == 100


def test_a_weight_that_falls_stays_where_it_ends() -> None:
    config = Td3BcConfig(updates=100, q_weight=2.5, q_weight_end=0.1)
    weights = [q_weight(config, step) for step in (0, 50, 100, 260)]
    assert weights == pytest.approx([2.5, 1.3, 0.1, 0.1])


def test_updates_from_the_dataset_alone_cannot_grow_later(
    whole: Run, tmp_path: Path
) -> None:
    shutil.copytree(whole.folder, tmp_path / "0")
    with pytest.raises(UsageError, match="gone on online after 100 updates"):
        trained("matd3-bc", tmp_path, updates=200, online_steps=60, resume=True)


def test_a_learner_that_cannot_observe_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(OfflineLearner, "observe")
    with pytest.raises(UsageError, match="iql learns from a dataset only"):
        trained("iql", tmp_path, online_steps=20)


def test_a_run_does_not_go_on_by_a_default_that_records_leave_out(
    tmp_path: Path,
) -> None:
    """Neither from another run nor from its own checkpoint."""
    short: dict[str, Any] = {"updates": 2, "curve_every": 2}
    begun = trained("cql", tmp_path / "begun", bound_penalty=0.3, **short)
    with pytest.raises(UsageError, match=r"with bound_penalty = 0\.3, expected 0\.0"):
        trained(
            "cql",
            tmp_path / "other",
            start=begun.folder,
            bound_penalty=0.0,
            online_steps=20,
            **short,
        )
    with pytest.raises(OtherConfigError, match=r"bound_penalty = 0\.3 \(now 0\.0\)"):
        trained("cql", tmp_path / "begun", resume=True, bound_penalty=0.0, **short)


# --- What is learnt from -----------------------------------------------------


@pytest.mark.parametrize("kept", [0.0, 0.3, 1.0])
def test_batches_keep_a_share_of_the_dataset(kept: float) -> None:
    arrays = some_episodes()
    own = replace(some_episodes(), rewards=arrays.rewards + 1000)
    batches = OfflineBatches(arrays, 1000, (0.0, 0.0), NoJudge(), [0])
    batches.next()
    batches.add(own, kept)
    assert batches.own == (len(arrays), arrays.steps)
    of_own = (batches.next().reward > 500).float().mean().item()
    assert of_own == pytest.approx(1 - kept, abs=0.05 * (0 < kept < 1))


def test_the_rest_is_the_discounted_return_of_an_episode_that_was_not_cut_off() -> None:
    arrays = some_episodes()
    batches = OfflineBatches(arrays, 64, (0.0, 0.0), NoJudge(), [0], discount=0.9)
    expected, cut = [], 0
    for number in range(len(arrays)):
        episode = arrays.episode(number)
        cut += episode.truncated[-1]
        for step in range(len(episode)):
            rest = episode.rewards[step:]
            value = (0.9 ** np.arange(len(rest)) * rest).sum()
            expected.append(-np.inf if episode.truncated[-1] else value)
    assert batches._steps["rest"] == pytest.approx(expected, rel=1e-5)
    assert 0 < cut < len(arrays)


def test_how_a_run_fares() -> None:
    success = [0.8, 0.5, 0.9, 0.96, 0.94]
    rows: list[Any] = [{"success/all": 0.1}]
    rows += [{"env_steps": 10 * i, "success/all": s} for i, s in enumerate(success)]
    measured = online_summary(rows)
    assert measured["online/dip"] == pytest.approx(0.3)
    assert measured["online/regret"] == pytest.approx(1 - np.mean(success))
    assert "online/steps_to_95" not in measured
    assert online_summary(rows[:5])["online/steps_to_95"] == 30
    later = [*rows, rows[4] | {"env_steps": 50}]
    assert online_summary(later)["online/steps_to_95"] == 50
    assert online_summary(rows[4:5])["online/steps_to_95"] == 30


@pytest.mark.slow
def test_the_study_of_the_ways_goes_online_from_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that learns from the data first, and RLPD, which has no updates before."""
    ways = ["matd3-bc-kept", "rlpd-kept"]
    folders = ["--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]
    words = ["ablate", "fine-tuning", "--engine", "mujoco", *folders, "--seeds", "0"]
    words += ["--settings", *ways, "--datasets", "script-2k-Grasp"]
    assert main([*words, "--budget", "smoke", "--workers", "1"]) == 0
    assert "| RLPD |" in capsys.readouterr().out
    (table,) = (tmp_path / "out").glob("fine-tuning-part.csv")
    assert [row["setting"] for row in read_rows(table)] == ways
    for way in ways:
        run = tmp_path / "runs/script-2k-Grasp" / way / "0"
        rows = read_metrics(run)
        assert rows[-1]["env_steps"] >= 8 and "online/regret" in rows[-1]


def test_own_episodes_are_explored_with_the_noise_that_is_asked_for(
    make_episode: Callable[..., Episode], tmp_path: Path
) -> None:
    """In cycles of so many episodes, each with a number of its own."""
    config = MabcConfig(hidden=(8,), batch_size=8)
    learner = Mabc(config, some_episodes(), make_task(), [0])
    explored: list[dict[str, object]] = []
    numbers: list[int] = []

    def run(explorer: Explorer, cycle: Iterable[int]) -> Iterator[Episode]:
        explored.append(explorer.describe())
        for number in cycle:
            numbers.append(number)
            yield make_episode(number, steps=4)

    settings = FineTuning(
        online_steps=16, online_every=8, online_cycle=2, online_noise=0.3
    )
    point = {"success/all": 0.0, "return/all": 0.0}
    fine_tune(learner, tmp_path, settings, run, lambda policy: point)  # type: ignore[arg-type,return-value]
    assert numbers == [0, 1, 2, 3] and len(explored) == 2
    for each in explored:
        assert (each["noise"], each["random_share"]) == (0.3, 0.0)


@pytest.mark.parametrize("files", [0, 1, 2])
def test_a_copy_of_a_start_that_is_stopped_has_no_checkpoint_yet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: int
) -> None:
    """With one it would be gone on from, though its rows are not there."""
    start, run, number = tmp_path / "start", tmp_path / "run", count()
    start.mkdir()
    for name in (METRICS, BEST, FILE):
        (start / name).write_text(name)

    def stopped(source: Path, target: Path) -> None:
        if next(number) == files:
            raise KeyboardInterrupt
        copyfile(source, target)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(shutil, "copyfile", stopped)
        copy_start(start, run)
    assert len([*run.iterdir()]) == files and not (run / FILE).exists()
    copy_start(start, run)
    assert {path.name: path.read_text() for path in run.iterdir()} == {
        name: name for name in (METRICS, BEST, FILE)
    }
