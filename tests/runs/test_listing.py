"""The list of runs: a damaged one stands there with the reason, beside the others."""

import json
import shutil
import threading
from pathlib import Path
from typing import Any

import pytest

from marl_mm.cli import main
from marl_mm.errors import CheckpointError
from marl_mm.runs.folder import CURVE, EVALUATION, read_evaluation
from marl_mm.runs.run import Run, find_runs

Output = pytest.CaptureFixture[str]

CONFIG: dict[str, Any] = {
    "algorithm": "mabc",
    "seed": 0,
    "task": "Reach-v0",
    "dataset": {"id": "marl_mm/reach/pd-v0", "path": "pd", "fingerprint": "0"},
    "updates": 40,
}

EPISODE: dict[str, Any] = {
    "index": 0,
    "seed": 0,
    "goal": [0.1, 0.2, 0.3],
    "direction": "forward",
    "success": True,
    "steps": 12,
    "return": -3.5,
    "alpha": 0.5,
}

RESULT: dict[str, Any] = {
    "policy": "mabc",
    "policy_config": {},
    "task": "Reach-v0",
    "overrides": {},
    "seed": 0,
    "episodes": [EPISODE],
}


def make_run(
    folder: Path, config: dict[str, Any] = CONFIG, result: Any = RESULT
) -> Path:
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps(config))
    (folder / EVALUATION).write_text(json.dumps(result))
    (folder / "metrics.jsonl").write_text('{"step": 40}\n')
    return folder


def listed(folder: Path, capsys: Output) -> dict[str, dict[str, Any]]:
    """Rows of ``marl-mm runs`` by name; as a table it ends well, too."""
    assert main(["runs", str(folder)]) == 0
    capsys.readouterr()
    assert main(["runs", str(folder), "--json"]) == 0
    return {row["run"]: row for row in json.loads(capsys.readouterr().out)}


def in_episode(name: str, value: Any) -> dict[str, Any]:
    return RESULT | {"episodes": [EPISODE | {name: value}]}


RESULTS = {
    "text": (in_episode("alpha", "x"), "'alpha' is 'x', expected a number"),
    "return": (in_episode("return", None), "'return' is None, expected a number"),
    "large": (in_episode("d_mm", 10**400), "expected a number"),
    "goal": (in_episode("goal", 3), "'goal' is 3, expected a list of numbers"),
    "success": (in_episode("success", 3), "'success' is 3, expected true or false"),
    "direction": (in_episode("direction", []), "'direction' is [], expected a text"),
    "null": (RESULT | {"episodes": None}, "episodes: None is not a list"),
    "none": (RESULT | {"episodes": []}, "no episodes, expected at least one"),
    "numbers": (RESULT | {"episodes": [1]}, "is not a dict"),
    "lacking": (RESULT | {"episodes": [{}]}, "lacks 'goal'"),
    "policy": (RESULT | {"policy": 3}, "policy: int is not an instance of str"),
    "list": ([], "list is not a dict"),
}


@pytest.mark.parametrize("name", RESULTS)
def test_an_evaluation_of_other_values_is_refused(name: str, tmp_path: Path) -> None:
    result, reason = RESULTS[name]
    run = make_run(tmp_path / "run", result=result)
    with pytest.raises(CheckpointError) as refusal:
        read_evaluation(run / EVALUATION)
    assert str(run / EVALUATION) in str(refusal.value)
    assert reason in str(refusal.value) and "\n" not in str(refusal.value)


def test_damaged_runs_stand_beside_the_others(tmp_path: Path, capsys: Output) -> None:
    configs: dict[str, Any] = {
        "dataset list": CONFIG | {"dataset": [1]},
        "dataset without id": CONFIG | {"dataset": {"path": "pd"}},
        "no seed": CONFIG | {"seed": None},
    }
    for name, config in configs.items():
        make_run(tmp_path / name, config=config)
    for name, (result, _) in RESULTS.items():
        make_run(tmp_path / name, result=result)
    (tmp_path / "folder" / "config.json").mkdir(parents=True)
    make_run(tmp_path / "good")
    rows = listed(tmp_path, capsys)
    assert rows.keys() == {*configs, *RESULTS, "folder", "good"}
    assert rows["good"]["success [%]"] == 100.0 and rows["good"]["note"] is None
    for name in rows.keys() - {"good"}:
        assert rows[name]["note"] and rows[name]["algorithm"] is None
    for name, (_, reason) in RESULTS.items():
        assert reason in rows[name]["note"]


def test_what_is_no_run_is_not_listed(tmp_path: Path) -> None:
    """A sweep has a config of its own, and so has a seed of a submission; a folder is
    hidden until it is whole."""
    make_run(tmp_path / "good")
    make_run(tmp_path / ".good.0123456789abcdef.new")
    (tmp_path / "alpha").mkdir()
    (tmp_path / "alpha" / "config.json").write_text('{"alphas": [0, 1]}')
    make_run(tmp_path / "submitted" / "0")
    (tmp_path / "submitted" / "0" / "episodes.json").write_text("{}")
    (tmp_path / "number").mkdir()
    (tmp_path / "number" / "config.json").write_text("3")  # damaged, and told so
    found = [run.folder.name for run in find_runs(tmp_path)]
    assert found == ["good", "number"]


def test_runs_are_listed_while_another_process_removes_folders(tmp_path: Path) -> None:
    make_run(tmp_path / "good")
    done = threading.Event()

    def work() -> None:
        while not done.is_set():
            (tmp_path / "bad" / ".0.new").mkdir(parents=True)
            shutil.rmtree(tmp_path / "bad")

    worker = threading.Thread(target=work)
    worker.start()
    try:
        found = [find_runs(tmp_path) for _ in range(500)]
    finally:
        done.set()
        worker.join()
    assert {len(runs) for runs in found} == {1}


@pytest.mark.parametrize("name", ["a\x1b]0;title\x07", "a\u202eb", "a\n  b", "[red]a"])
def test_names_of_runs_are_spelled_out(
    name: str, tmp_path: Path, capsys: Output
) -> None:
    make_run(tmp_path / name)
    assert main(["runs", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert f" {ascii(name)[1:-1]} " in shown
    assert not {"\x1b", "\x07", "\u202e"} & set(shown) and "\n  b" not in shown


def test_a_notebook_shows_no_picture_from_elsewhere(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    (run / EVALUATION).unlink()
    (tmp_path / "secret").write_text("secret")
    (run / CURVE).symlink_to(tmp_path / "secret")
    with pytest.raises(CheckpointError, match="is a link out of its folder"):
        Run(run)._repr_html_()
