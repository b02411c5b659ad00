"""Offline to online: runs from a dataset that go on with episodes of their own."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import marl_mm
from marl_mm.algorithms.checkpoint import FILE, read_checkpoint
from marl_mm.algorithms.fine_tune import fared
from marl_mm.algorithms.offline_batches import OfflineBatches
from marl_mm.algorithms.offline_learner import OfflineLearner
from marl_mm.algorithms.runlog import METRICS, read_metrics
from marl_mm.contracts.learners import some_episodes
from marl_mm.envs.rollout import Rollouts
from marl_mm.errors import OtherConfigError, UsageError
from marl_mm.runs.run import Run
from marl_mm.sim.world import check_engine
from tests.algorithms.games import NoJudge

SMALL: dict[str, Any] = {
    **{"updates": 100, "hidden": (8, 8), "batch_size": 16, "engine": "mujoco"},
    **{"curve_every": 100, "curve_episodes": 1, "eval_episodes": 1, "max_steps": 5},
    **{"online_every": 20, "online_cycle": 2, "precision": "highest", "logger": ()},
}
KEPT = (FILE, METRICS)


def trained(name: str, out: Path, **settings: Any) -> Run:
    (run,) = marl_mm.train(name, "good-5k", out=out, **SMALL | settings)
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
    return {name: SMALL[name] for name in ("online_every", "online_cycle", "logger")}


def test_more_own_steps_are_gone_on_to(whole: Run, tmp_path: Path) -> None:
    trained("matd3-bc", tmp_path, online_steps=40)
    trained("matd3-bc", tmp_path, online_steps=60, resume=True)
    assert same(tmp_path / "0", whole.folder)


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


# --- What is refused ---------------------------------------------------------


def test_what_cannot_go_on_is_refused_before_any_work(
    whole: Run, tmp_path: Path
) -> None:
    def refused(words: str, name: str = "matd3-bc", **settings: Any) -> None:
        with pytest.raises((UsageError, OtherConfigError), match=words):
            trained(name, tmp_path / "new", **{"online_steps": 20} | settings)
        assert not (tmp_path / "new").exists()

    refused("no checkpoint in .*nowhere", start=tmp_path / "nowhere")
    refused("is a run of matd3-bc, expected td3-bc", "td3-bc", start=whole.folder)
    refused("has gone on online already", start=whole.folder)
    refused("kept is 1.5, expected 0 to 1", kept=1.5)
    refused("online_every is 0, expected >= 1", online_every=0)
    refused("`updates` is 0 and `online_steps` too", "rlpd", updates=0, online_steps=0)


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


def test_the_rest_is_the_discounted_return_of_the_episode() -> None:
    arrays = some_episodes()
    batches = OfflineBatches(arrays, 64, (0.0, 0.0), NoJudge(), [0], discount=0.9)
    expected = []
    for number in range(len(arrays)):
        rewards = arrays.episode(number).rewards
        for step in range(len(rewards)):
            rest = rewards[step:]
            expected.append((0.9 ** np.arange(len(rest)) * rest).sum())
    assert batches._steps["rest"] == pytest.approx(expected, rel=1e-5)


def test_how_a_run_fares() -> None:
    success = [0.8, 0.5, 0.9, 0.96, 0.94]
    rows: list[Any] = [{"success/all": 0.1}]
    rows += [{"env_steps": 10 * i, "success/all": s} for i, s in enumerate(success)]
    measured = fared(rows)
    assert measured["online/dip"] == pytest.approx(0.3)
    assert measured["online/regret"] == pytest.approx(1 - np.mean(success))
    assert measured["online/steps_to_95"] == 30
    assert "online/steps_to_95" not in fared(rows[:4])
