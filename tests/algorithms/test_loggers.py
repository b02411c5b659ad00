"""Loggers: they say what the record says, resume as it does, and change nothing."""

import csv
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from marl_mm.algorithms.checkpoint import BEST, FILE
from marl_mm.algorithms.loggers import CSV, LOGGERS, check_loggers
from marl_mm.algorithms.mabc import Mabc
from marl_mm.algorithms.mabc_config import MabcConfig
from marl_mm.algorithms.policy import LearnedPolicy
from marl_mm.algorithms.runlog import METRICS, CurvePoint, RunLog, read_metrics
from marl_mm.algorithms.train import resume_seeds, train
from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.envs.registry import make_task
from marl_mm.episode import Episode
from marl_mm.errors import UsageError

CONFIG = MabcConfig(updates=400, batch_size=8, hidden=(4,))
WITH_WANDB = pytest.mark.skipif(find_spec("wandb") is None, reason="needs wandb")


@pytest.fixture
def arrays(make_episode: Callable[..., Episode]) -> EpisodeArrays:
    return arrays_of([make_episode(i, 4) for i in range(6)], "x")


def weighed(policy: LearnedPolicy) -> CurvePoint:
    action = policy.act(np.ones(10))
    return {"success/all": float(abs(action[0])), "return/all": float(action[1])}


def learn(
    arrays: EpisodeArrays, runs: Sequence[Path], loggers: Sequence[str], updates: int
) -> None:
    config = replace(CONFIG, updates=updates)
    seeds = range(len(runs))
    algorithm = Mabc(config, arrays, make_task(), seeds)
    if (runs[0] / FILE).exists():
        resume_seeds(algorithm, runs, ["updates"])
    train(algorithm, runs, weighed, 100, loggers=loggers)


def sent(run: Path) -> list[dict[str, float]]:
    """Rows in the local files of Weights & Biases, oldest first."""
    rows = []
    for path in run.glob("wandb/*run-*/*.wandb"):
        end = time.monotonic() + 60  # its own process writes them
        while not (records := recorded(path)) or not records[-1].HasField("exit"):
            assert time.monotonic() < end
            time.sleep(0.1)
        for record in records:
            if record.HasField("history"):
                items = {i.key or i.nested_key[0]: i for i in record.history.item}
                rows.append({k: float(i.value_json) for k, i in items.items()})
    return sorted(rows, key=lambda row: row["_timestamp"])


def recorded(path: Path) -> list[Any]:
    from wandb.proto import wandb_internal_pb2
    from wandb.sdk.internal.datastore import DataStore

    store, records = DataStore(), []
    store.open_for_scan(str(path))
    while (data := store.scan_data()) is not None:
        records.append(wandb_internal_pb2.Record())
        records[-1].ParseFromString(data)
    return records


def tabled(run: Path) -> list[dict[str, float]]:
    """Rows of ``metrics.csv``, without what a row has not."""
    with (run / CSV).open(newline="") as file:
        return [
            {key: float(value) for key, value in row.items() if value}
            for row in csv.DictReader(file)
        ]


def ran_on_from_a_stop(arrays: EpisodeArrays, run: Path, loggers: list[str]) -> None:
    """A run that was cut off after a row beyond its checkpoint, and resumed."""
    learn(arrays, [run], loggers, 200)
    checkpoint = (run / FILE).read_bytes()
    learn(arrays, [run], loggers, 300)
    (run / FILE).write_bytes(checkpoint)
    learn(arrays, [run], loggers, CONFIG.updates)


def test_csv_has_the_rows_of_the_record_after_a_stop_too(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    ran_on_from_a_stop(arrays, tmp_path, ["csv"])
    assert tabled(tmp_path) == read_metrics(tmp_path)
    assert len(tabled(tmp_path)) == 5
    assert not [*tmp_path.glob("events*")]  # of TensorBoard, which nobody asked for


def test_tensorboard_has_the_rows_of_the_record_after_a_stop_too(
    arrays: EpisodeArrays, tmp_path: Path
) -> None:
    ran_on_from_a_stop(arrays, tmp_path, ["tensorboard"])
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    shown = [(event.step, event.value) for event in events.Scalars("imitation/alpha")]
    rows = [row for row in read_metrics(tmp_path) if "imitation/alpha" in row]
    assert shown == [(row["step"], np.float32(row["imitation/alpha"])) for row in rows]


@WITH_WANDB
@pytest.mark.slow
def test_weights_and_biases_goes_on_offline_with_the_same_run(
    arrays: EpisodeArrays, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WANDB_MODE", "offline")
    ran_on_from_a_stop(arrays, tmp_path, ["wandb"])
    parts = [path.name for path in tmp_path.glob("wandb/offline-run-*/run-*.wandb")]
    assert len(parts) == 3 and len({*parts}) == 1
    rows = sent(tmp_path)
    assert [row.pop("_step") for row in rows] == [0, 100, 200, 300, 300, 400]
    own = [{k: v for k, v in row.items() if not k.startswith("_")} for row in rows]
    assert own.pop(3) == own[3]  # made once more, and the same
    record = read_metrics(tmp_path)
    assert own == [{k: v for k, v in row.items() if k != "step"} for row in record]


@WITH_WANDB
@pytest.mark.slow
def test_loggers_leave_runs_of_several_seeds_as_they_are(
    arrays: EpisodeArrays, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WANDB_MODE", "offline")
    for name, loggers in (("none", []), ("all", [*LOGGERS])):
        learn(arrays, [tmp_path / name / "0", tmp_path / name / "1"], loggers, 300)
    for seed in "01":
        for file in (FILE, BEST, METRICS):
            without = (tmp_path / "none" / seed / file).read_bytes()
            assert (tmp_path / "all" / seed / file).read_bytes() == without
        rows, record = sent(tmp_path / "all" / seed), read_metrics(tmp_path / "all/0")
        own = [row["imitation/alpha"] for row in rows if "imitation/alpha" in row]
        theirs = [row["imitation/alpha"] for row in record if "imitation/alpha" in row]
        assert (own == theirs) == (seed == "0")  # each has a run of its own


def test_a_logger_that_cannot_start_is_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match=r"no logger 'mlflow', .* tensorboard, csv"):
        RunLog(tmp_path, "step", 0, ["mlflow"])
    monkeypatch.setitem(sys.modules, "wandb", None)
    monkeypatch.setattr("marl_mm.algorithms.loggers.find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"pip install -e '.\[wandb\]'"):
        check_loggers(["wandb"])


@WITH_WANDB
@pytest.mark.slow
def test_weights_and_biases_without_an_account_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("WANDB_MODE", "WANDB_API_KEY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    with pytest.raises(UsageError, match="WANDB_MODE=offline"):
        RunLog(tmp_path, "step", 0, ["wandb"])
    monkeypatch.setenv("WANDB_MODE", "offline")
    check_loggers(["wandb"])
