"""The command line as a user meets it: one clear line and the right exit code."""

import io
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

import marl_mm
from marl_mm.cli import COMMANDS, main
from marl_mm.datasets.arrays import EpisodeArrays, arrays_of
from marl_mm.datasets.dataset import load_dataset
from marl_mm.datasets.journal import Journal
from marl_mm.datasets.location import locate
from marl_mm.datasets.provenance import Provenance
from marl_mm.datasets.shipped import IDS
from marl_mm.datasets.storage import write_dataset
from marl_mm.envs.registry import TASKS
from marl_mm.envs.task import Task
from marl_mm.envs.tasks.reach import Reach
from marl_mm.episode import Episode
from marl_mm.errors import UsageError
from marl_mm.runs.policies import own_task
from marl_mm.sim.config import Camera

ID = "marl_mm/reach/test-v0"
PROVENANCE = Provenance(task="Reach-v0", collector="pd", seed=0, attempts=6)

SHIPPED = str(Path(marl_mm.__file__).parent / "datasets/shipped/good-5k.json")

Output = pytest.CaptureFixture[str]


def run(*arguments: str) -> int:
    """Exit code of the command, as the shell would see it."""
    try:
        return main(arguments)
    except SystemExit as end:  # from the parser of options
        return int(end.code or 0)


@pytest.fixture
def dataset(datasets_home: Path, episodes: list[Episode]) -> Path:
    write_dataset(locate(ID), arrays_of(episodes, ID), PROVENANCE)
    return datasets_home / ID


@pytest.fixture
def run_folder(dataset: Path, tmp_path: Path) -> Path:
    out = tmp_path / "runs"
    arguments = ["--updates", "100", "--curve-every", "100", "--curve-episodes", "1"]
    arguments += ["--max-steps", "4"]
    assert run("train", "mabc", "--dataset", ID, "--out", str(out), *arguments,
               "--eval-episodes", "2", "--workers", "1") == 0  # fmt: skip
    return out / "0"


def one_line(output: Output) -> str:
    """The only line on stderr."""
    captured = output.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("marl-mm: ")
    return lines[0]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name: str, capsys: Output) -> None:
    assert run(name, "--help") == 0
    assert "usage: marl-mm " + name in capsys.readouterr().out


@pytest.mark.parametrize("command", ["play", "train mabc", "collect varied"])
def test_a_help_does_not_show_none(command: str, capsys: Output) -> None:
    """What it means stands in an option's text."""
    assert run(*command.split(), "--help") == 0
    assert not re.findall(r".*None\b.*|.*default: \).*", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("command", "words"),
    [  # an option of a function, of a dataclass, and a description
        ("play", "the name of a collector; or the robot alone"),
        ("collect random", "Default 10,000; when resuming as many as were asked for."),
        ("verify", "Then each goal is run again; where time is short, as many as fit"),
    ],
)
def test_helps_lines_are_those_of_the_terminal(
    command: str, words: str, monkeypatch: pytest.MonkeyPatch, capsys: Output
) -> None:
    monkeypatch.setenv("COLUMNS", "240")  # wider than a line of the source
    assert run(*command.split(), "--help") == 0
    wide = capsys.readouterr().out
    assert words in wide
    monkeypatch.setenv("COLUMNS", "60")
    assert run(*command.split(), "--help") == 0
    narrow = capsys.readouterr().out.partition("\n\n")[2]  # without the usage
    assert max(map(len, narrow.splitlines())) == 60
    assert words not in narrow


def test_a_help_tells_every_task_once(capsys: Output) -> None:
    """Those of a kind in three levels as KIND[-easy|-hard]-v0."""
    assert run("check", "--help") == 0
    words = re.findall(r"(\w+)(?:\[(\S+)\])?-v0(?!\))", capsys.readouterr().out)
    told = [
        f"{kind}{level}-v0"
        for kind, levels in words
        for level in {"", *levels.split("|")}
    ]
    assert sorted(told) == sorted(TASKS.names())


@pytest.mark.parametrize("command", ["", "train", "train mabc", "bench", "algorithms"])
def test_helps_come_without_heavy_imports(command: str) -> None:
    code = (
        "import sys, contextlib; from marl_mm.cli import main\n"
        f"with contextlib.suppress(SystemExit): main({[*command.split(), '--help']})\n"
        "heavy = {'torch', 'numba', 'matplotlib', 'pybullet', 'pinocchio', 'minari'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True
    )
    assert b"usage: marl-mm" in shown.stdout


def test_workers_that_run_episodes_do_without_torch() -> None:
    """It takes seconds and memory, in each of them."""
    code = (
        "import sys, marl_mm.commands.collect, marl_mm.eval.metrics;"
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_no_command_is_a_usage_error(capsys: Output) -> None:
    assert run() == 2
    assert "quickstart" in capsys.readouterr().out


def test_unknown_commands_are_named(capsys: Output) -> None:
    assert run("fly") == 2
    assert "unknown command 'fly', expected one of quickstart" in one_line(capsys)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["collect", "pd", "--steps=-5"], "--steps is -5, expected >= 1"),
        (["collect", "pd", "--steps", "-5"], "--steps is -5, expected >= 1"),
        (["collect", "random", "--workers", "0"], "--workers is 0"),
        (["collect", "random", "--seed", "-1"], "the seed is -1"),
        (["collect", "pd", "--max-steps", "0"], "--max-steps is 0"),
        (["collect", "pd", "--alpha", "1.5"], "alpha is 1.5, expected a number in"),
        (["collect", "pd", "--task", "Fly-v0"], "unknown task 'Fly-v0'"),
        (["collect", "pd", "--steps", "1.5"], "--steps is '1.5', expected INT; see"),
        (
            ["collect", "pd", "--engine", "x"],
            "is 'x', expected one of bullet, mujoco;",
        ),
        (["collect", "pd", "5"], "unexpected 5; see marl-mm collect pd --help"),
        (["collect", "pd", "--task", "Bar-v0"], "pd does not set left_alpha"),
        (
            ["collect", "pd", "--stpes", "5"],
            "unexpected --stpes (did you mean --steps?)",
        ),
        (
            ["train", "iql", "--dataset", "good-5k", "--distillation", "3"],
            "unexpected --distillation; see marl-mm train iql --help",
        ),
        (["train", "ddpg", "--seed", "0"], "--seed (did you mean --seeds?)"),
        (
            ["train", "mabc", "--dataset", "good-5k", "--seeds", "0,1"],
            "--seeds is '0,1', expected [INT [INT ...]];",
        ),
        (["train", "mabc", "--resume", "--out", "no"], "no run in no to resume: leave"),
        (["train", "--config"], "--config is '', expected a run or its config.json"),
        (["eval", SHIPPED], "good-5k.json is no checkpoint, expected a run folder"),
        (
            ["train", "sac"],
            "train knows no 'sac', expected one of bc, mabc",
        ),
        (["train", "mabc"], "Missing from marl-mm train mabc: --dataset"),
        (
            ["train", "fql", "--dataset", "good-5k", "--seeds", str(2**31)],
            "the seed is 2147483648, expected below 2,147,483,648",
        ),
        (["play", "pd", "--camera.width", "0"], "camera width is 0, expected even"),
        (
            ["collect", "pd", "--dataset", "marl_mm/reach/pd"],
            "is no id, expected marl_mm/FOLDER",
        ),
        (["eval"], "no policy given"),
        (["collect", "random", "--dataset", "/dev/null/x"], "cannot write"),
        (["quickstart", "--out", "/"], "/"),
        (
            ["eval", "nowhere"],
            "no policy 'nowhere': expected pretrained, pd, medium, random, scripted",
        ),
        (["eval", "pd", "--episodes", "0"], "--episodes is 0"),
        (["play", "pd", "--video", "x.avi"], ".mp4 or .gif"),
        (["play", "pd", "--fps", "2000"], "--fps is 2000, expected at most 240"),
        (["collect", "pd", "--workers", "9999"], "is 9999, expected 1 to"),
        (
            ["play", "scripted", "--task", "Grasp-v0", "--direction", "backward"],
            "--direction is not for Grasp-v0: its seed draws the goal",
        ),
        (["play", "pd", "--strip", "x.gif"], "film strip x.gif ends in"),
        (["play", "arm-reach", "--strip", "x.png"], "--strip is for films of episodes"),
        (
            ["play", "arm-reach", "--task", "Gate-v0", "--seed", "3"],
            "--seed and --task: arm-reach has no task",
        ),
        (["play", "pd", "--angle", "20"], "pd has no such motion: arm-reach and base-"),
        (["play", "pd", "--gui", "--video", "x.mp4"], "window: leave out --video"),
        (["bench", "control", "--steps", "-1"], "--steps is -1"),
        (["bench", "abuse", "--ticks", "0"], "--ticks is 0"),
        (["bench", "train", "--seeds", "0"], "--seeds is 0"),
        (["bench", "data", "--workers"], "--workers is 0"),
        (["play", "base-turn", "--angle", "400"], "--angle is 400.0, expected -180"),
        (["play", "arm-reach", "--seconds", "0"], "--seconds is 0.0, expected 0.1"),
        (["sweep-alpha", "--alphas", "1"], "--alphas is 1, expected >= 2"),
        (["sweep-alpha", "--resume", "--overwrite"], "contradict each other"),
        (["sweep-alpha", "--goals", "3"], "--goals is 3, expected an even number"),
        (["sweep-alpha", "--tasks", "Fly-v0"], "--tasks is Fly-v0, expected some of"),
        (["quickstart", "--workers", "-1"], "--workers is -1"),
        (["datasets", "show", "marl_mm/reach/no-v0"], "no dataset"),
        (["datasets", "split", "good-5k", "--out", "/"], "--out is '/', expected the"),
        (["train", "mabc", "--dataset", "marl_mm/reach/no-v0"], "no dataset"),
    ],
)
def test_usage_errors_are_one_line_and_exit_2(
    arguments: list[str], message: str, capsys: Output, datasets_home: Path
) -> None:
    assert run(*arguments) == 2
    assert message in one_line(capsys)


def test_a_truncated_dataset_fails_with_1(dataset: Path, capsys: Output) -> None:
    path = dataset / "data" / "main_data.hdf5"
    path.write_bytes(path.read_bytes()[:1000])
    assert run("train", "mabc", "--dataset", ID) == 1
    assert "main_data.hdf5 is damaged" in one_line(capsys)
    assert run("datasets", "show", ID) == 1
    assert "datasets delete" in one_line(capsys)


def test_nothing_is_overwritten_unasked(
    dataset: Path, tmp_path: Path, capsys: Output
) -> None:
    content = (dataset / "data" / "main_data.hdf5").read_bytes()
    assert run("collect", "random", "--steps", "5", "--dataset", ID) == 2
    assert "--overwrite" in one_line(capsys)
    assert (dataset / "data" / "main_data.hdf5").read_bytes() == content
    for arguments in (
        ["quickstart", "--out", str(tmp_path)],
        ["eval", "pd", "--out", str(dataset / "data" / "metadata.json")],
    ):
        assert run(*arguments) == 2
        assert "exists already" in one_line(capsys)
    shutil.copytree(dataset, dataset.with_name("test-first-v0"))
    for words in (
        ["filter", ID, "--out", ID, "--min-return", "-99"],
        ["split", "marl_mm/reach/test-first-v0", "--out", ID],
        ["mix", f"{ID}:3", "--out", ID],
        ["import", str(dataset), "--out", str(dataset)],
    ):
        assert run("datasets", *words, "--overwrite") == 2
        assert "which it is made of" in one_line(capsys)
    assert (dataset / "data" / "main_data.hdf5").read_bytes() == content
    assert run("quickstart", "--out", str(tmp_path), "--overwrite") == 2
    assert "has no quickstart.json of marl-mm" in one_line(capsys)
    film = tmp_path / "film.mp4"
    film.write_text("mine")
    assert run("play", "pd", "--video", str(film)) == 2
    assert "exists already" in one_line(capsys)
    assert film.read_text() == "mine"


def test_datasets_list_and_show(dataset: Path, capsys: Output) -> None:
    assert run("datasets", "list", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    shown = [(row["id"], row["episodes"]) for row in rows]
    ships = {(row["id"], row["episodes"]) for row in rows if "ships" in row["note"]}
    assert shown[:2] == [(ID, 6), ("marl_mm/reach/good-5k-v0", 504)]
    assert ships == set(shown[1:]) and {name for name, _ in ships} == set(IDS)
    assert run("datasets", "show", ID, "--json") == 0
    card = json.loads(capsys.readouterr().out)
    assert card["steps"] == rows[0]["steps"]
    assert card["success"]["backward"] == {"episodes": 3, "rate": 2 / 3}
    assert sum(card["alpha_histogram"]["counts"]) == card["steps"]
    assert run("datasets", "list") == 0
    assert run("datasets", "show", ID) == 0


def test_no_datasets_says_how_to_make_one(datasets_home: Path, capsys: Output) -> None:
    assert run("datasets", "list") == 0
    listed = capsys.readouterr().out
    assert "marl-mm collect pd" in listed and "ships with" in listed


def stopped(dataset: Path) -> tuple[EpisodeArrays, Provenance]:
    """A dataset's episodes, and what would be said if its collection were stopped."""
    whole = load_dataset(dataset)
    return whole.arrays, replace(whole.provenance, complete=False)


def test_what_was_typed_wrongly_or_stopped_is_told(
    dataset: Path, tmp_path: Path, capsys: Output
) -> None:
    for words in (
        ["datasets", "show", "tset"],
        ["train", "mabc", "--dataset", "tests"],
    ):
        assert run(*words) == 2
        assert f"did you mean {ID}?" in one_line(capsys)
    location = locate("begun")
    with Journal(location.working) as journal:
        journal.begin({"seed": 0})
    assert run("datasets", "show", "begun") == 2
    assert "begun and not finished" in one_line(capsys)
    assert run("datasets", "list", "--json") == 0
    rows = {row["id"]: row for row in json.loads(capsys.readouterr().out)}
    assert "--resume" in rows["marl_mm/reach/begun-v0"]["note"]
    write_dataset(locate("begun"), *stopped(dataset))
    assert run("datasets", "list", "--json") == 0
    listed = [row["id"] for row in json.loads(capsys.readouterr().out)]
    assert listed.count("marl_mm/reach/begun-v0") == 1
    assert run("datasets", "export", "begun", "--out", str(tmp_path / "x.h5")) == 0
    assert "is of a collection that was stopped" in one_line(capsys)
    assert run("datasets", "verify", "begun") == 0
    assert "is of a collection that was stopped" in one_line(capsys)
    path = dataset / "data/main_data.hdf5"
    path.write_bytes(path.read_bytes()[:-100])
    for names in (("begun", ID), (ID, "begun")):  # one of two is enough
        assert run("datasets", "verify", *names) == 1
        assert f"not as they should be: {ID}" in capsys.readouterr().err
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdin", None)  # a process whose input was closed
        assert run("datasets", "delete", "begun") == 2
    assert "there is no terminal to confirm on" in one_line(capsys)
    assert run("datasets", "delete", "begun", "--yes", "--json") == 0
    assert json.loads(capsys.readouterr().out)["deleted"] == str(location.folder)
    assert not location.working.exists()


class Terminal(io.StringIO):
    """What somebody types."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("answer", "gone"),
    [
        *(("y\n", True), ("YES \n", True)),
        *(("\n", False), ("n\n", False), ("what?\n", False), ("", False)),
    ],
)
def test_a_dataset_is_deleted_after_a_yes_alone(
    answer: str,
    gone: bool,
    dataset: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Output,
) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal(answer))
    assert run("datasets", "delete", ID) == 0
    assert f"delete {dataset}? [y/N]" in capsys.readouterr().err
    assert dataset.exists() != gone


@pytest.mark.slow
def test_collect_writes_what_it_says(datasets_home: Path, capsys: Output) -> None:
    arguments = ["--steps", "20", "--workers", "1", "--seed", "3", "--json"]
    assert run("collect", "pd", *arguments) == 0
    card = json.loads(capsys.readouterr().out)
    assert card["id"] == "marl_mm/reach/pd-v0"
    assert card["steps"] >= 20
    assert card["seed"] == 3
    assert card["success"]["forward"]["rate"] in (1.0, None)


@pytest.mark.slow
def test_collecting_leaves_the_registry_alone(datasets_home: Path) -> None:
    options = ["--steps", "2", "--max-steps", "2", "--workers", "1"]
    assert run("collect", "random", *options) == 0
    assert "overrides" not in gymnasium.spec("marl_mm/Reach-v0").kwargs


@pytest.mark.slow
def test_a_relative_datasets_root_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Output
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", "data sets")
    options = ["--steps", "2", "--max-steps", "2", "--workers", "1", "--json"]
    assert run("collect", "random", *options) == 0
    assert json.loads(capsys.readouterr().out)["id"] == "marl_mm/reach/random-v0"
    assert (tmp_path / "data sets/marl_mm/reach/random-v0/data").is_dir()


@pytest.mark.slow
def test_a_run_is_a_folder(run_folder: Path, capsys: Output) -> None:
    names = {path.name for path in run_folder.iterdir()}
    files = {"config.json", "metrics.jsonl", "eval.json", "checkpoint.pt", "best.pt"}
    events = {name for name in names if name.startswith("events.out.tfevents.")}
    assert len(events) == 1  # TensorBoard's
    assert names - events == files | {"learning_curve.png"}
    evaluation = json.loads((run_folder / "eval.json").read_text())
    assert len(evaluation["episodes"]) == 2
    assert 0 <= evaluation["success_rate"] <= 1
    assert len(evaluation["interval"]) == 2
    config = json.loads((run_folder / "config.json").read_text())
    assert config["algorithm"] == "mabc"
    assert config["updates"] == 100


@pytest.mark.slow
def test_train_refuses_and_resumes(run_folder: Path, capsys: Output) -> None:
    out = str(run_folder.parent)
    base = ["train", "mabc", "--dataset", ID, "--out", out, "--eval-episodes", "2"]
    capsys.readouterr()
    assert run(*base) == 2
    assert "exists already" in one_line(capsys)
    assert run(*base, "--resume", "--batch-size", "32") == 2
    assert "batch_size = 256 (now 32)" in one_line(capsys)
    options = ["--updates", "100", "--workers", "1", "--curve-episodes", "1"]
    assert run(*base, "--resume", *options, "--task", "SmoothReach-v0") == 2
    assert "task = Reach-v0 (now SmoothReach-v0)" in one_line(capsys)
    assert run(*base, "--resume", *options) == 0
    assert run("train", "mabc", "--out", out, "--resume", "--eval-episodes", "2") == 0
    assert run(*base, "--task", "Fly-v0", "--seeds", "8") == 2
    assert not (run_folder.parent / "8").exists()
    assert run(*base, "--resume", *options, "--seeds", "7") == 2
    assert run(*base, "--seeds") == 2
    shown = capsys.readouterr().err
    assert "to resume, only of 0" in shown and "names no seed" in shown
    assert run(*base, "--resume", *options, "--seeds", "0", "3") == 0
    assert (run_folder.parent / "3" / "eval.json").exists()


@pytest.mark.slow
def test_a_refused_command_leaves_finished_runs_as_they_are(
    run_folder: Path, tmp_path: Path, capsys: Output
) -> None:
    before = {path: path.read_bytes() for path in run_folder.rglob("*")}
    out, fresh = str(run_folder.parent), str(tmp_path / "fresh")
    base, record = ["train", "mabc", "--dataset", ID], str(run_folder)
    sweep = ["sweep-alpha", "--out", out, "--overwrite"]
    capsys.readouterr()
    for words, complaint in (
        ([*base, "--out", out, "--overwrite", "--workers", "9999"], "workers is 9999"),
        ([*base, "--out", out, "--overwrite", "--max-steps", "0"], "max_steps is 0"),
        ([*base, "--out", fresh, "--max-steps", "-3"], "max_steps is -3"),
        (["train", "--config", record, "--preset", "paper"], "leave out --preset"),
        (sweep, "has no config.json of marl-mm and is not replaced"),
        (["eval", record, "--pd.kp", "3"], "--pd.* have no effect: pd is not among"),
        (["play", "random", "--pd.kp", "3"], "--pd.* have no effect: pd is not among"),
    ):
        assert run(*words) == 2, words
        assert complaint in one_line(capsys)
    assert {path: path.read_bytes() for path in run_folder.rglob("*")} == before
    assert not Path(fresh).exists()


@pytest.mark.slow
def test_a_camera_that_is_asked_for_keeps_the_rest_of_the_tasks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def seen(*names: str, **settings: Any) -> Any:
        asked.append(settings["camera"])
        raise UsageError("seen")

    monkeypatch.setattr("marl_mm.commands.play.play", seen)
    film = ["--task", "Gate-v0", "--video", str(tmp_path / "f.gif")]
    usual = Camera()  # a default of other tasks, too, where it is asked for
    assert run("play", *film, "--camera.yaw", str(usual.yaw)) == 2
    assert run("play", *film) == 2
    own = TASKS.get("Gate-v0").camera
    assert own.yaw != usual.yaw
    assert asked == [replace(own, yaw=usual.yaw), own]


@pytest.mark.slow
def test_a_checkpoint_of_another_algorithm_acts_but_does_not_go_on(
    run_folder: Path, capsys: Output
) -> None:
    path = run_folder / "checkpoint.pt"
    checkpoint = torch.load(path, weights_only=True)
    torch.save({**checkpoint, "algorithm": "cql"}, path)
    few = ["--episodes", "1", "--max-steps", "2", "--workers", "1"]
    assert run("eval", str(path), *few) == 0
    capsys.readouterr()
    train = ["train", "mabc", "--out", str(run_folder.parent), "--resume"]
    assert run(*train, "--updates", "200") == 1
    assert "'cql', expected 'mabc'" in one_line(capsys)
    path.write_bytes(b"not a checkpoint")
    assert run("play", str(run_folder)) == 1
    assert "is damaged" in one_line(capsys)


@pytest.mark.slow
def test_eval_compares_policies_on_the_same_goals(
    run_folder: Path, tmp_path: Path, capsys: Output
) -> None:
    capsys.readouterr()
    out = tmp_path / "eval.json"
    arguments = ["--episodes", "2", "--workers", "1", "--max-steps", "3", "--json"]
    assert run("eval", str(run_folder), "pd", *arguments, "--out", str(out)) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(out.read_text())
    learned, pd = printed
    goals = [[row["goal"] for row in one["episodes"]] for one in (learned, pd)]
    assert goals[0] == goals[1]
    assert max(row["steps"] for row in pd["episodes"]) == 3


@pytest.mark.bullet
def test_a_policy_of_other_entries_is_refused(capsys: Output) -> None:
    for policy, complaint in (
        ("pretrained", "another layout than the task has: state opening [m] in"),
        ("pd", "pd does not set grip"),
    ):
        assert run("play", policy, "--task", "Grasp-v0", "--video", "x.mp4") == 2
        message = capsys.readouterr().err.splitlines()[-1]  # after the progress bar
        assert complaint in message
        assert not Path("x.mp4").exists()


def test_no_run_is_of_a_dataset_with_other_entries_than_its_task(
    tmp_path: Path, capsys: Output
) -> None:
    options = ["--dataset", "good-5k", "--task", "Grasp-v0", "--out", f"{tmp_path}/run"]
    assert run("train", "mabc", *options) == 2
    message = one_line(capsys)
    assert "good-5k-v0 is made for another layout than Grasp-v0 has" in message
    assert "agent balance sees held (only there)" in message
    assert not (tmp_path / "run").exists()


def test_runs_are_evaluated_on_their_own_task(tmp_path: Path) -> None:
    for name, task in (("a", "Grasp-v0"), ("b", "Grasp-v0"), ("c", "Reach-v0")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.json").write_text(json.dumps({"task": task}))
    (tmp_path / "a" / "best.pt").touch()
    a, b, c = (str(tmp_path / name) for name in "abc")
    assert own_task([a, b, "pd"]) == own_task([f"{a}/best.pt"]) == "Grasp-v0"
    assert own_task([c]) == own_task(["pd", "pretrained"]) == "Reach-v0"
    with pytest.raises(UsageError, match="choose one with `task`"):
        own_task([a, c])


@pytest.mark.slow
@pytest.mark.bullet
def test_the_script_plays_if_no_policy_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Output
) -> None:
    class Unscripted(Reach):
        expert = Task.expert

    small = ["--fps", "1", "--camera.width", "96", "--camera.height", "64"]
    strip = str(tmp_path / "film.png")
    for task in ([], ["--task", "Tray-v0"]):
        words = ["play", *task, "--strip", strip, "--max-steps", "7", "--overwrite"]
        assert run(*words, *small, "--engine", "mujoco") == 0
        assert ": scripted " in capsys.readouterr().out
    film = marl_mm.play(task="Reach-v0", max_steps=1, fps=1, engine="mujoco")
    assert film.policy == "scripted"
    monkeypatch.setitem(TASKS._things, "Reach-v0", Unscripted())
    film = marl_mm.play(max_steps=1, fps=1, engine="mujoco")
    assert (film.policy, film.task) == ("pd", "Reach-v0")
    assert run("play", "--help") == 0
    assert "Default the task's script" in capsys.readouterr().out


@pytest.mark.slow
def test_play_writes_a_film_or_a_strip_or_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Output
) -> None:
    monkeypatch.chdir(tmp_path)
    film = tmp_path / "film.mp4"
    options = ["--fps", "2", "--camera.width", "96", "--camera.height", "64"]
    strip = film.with_suffix(".png")
    options += ["--strip", str(strip), "--max-steps", "2"]
    assert run("play", "pd", *options) == 0
    assert strip.read_bytes().startswith(b"\x89PNG")
    assert list(tmp_path.iterdir()) == [strip]
    message = f"{strip}: pd did not reach the goal in 2 steps"
    assert message in capsys.readouterr().out
    assert run("play", "pd", *options, "--video", str(film), "--overwrite") == 0
    assert film.stat().st_size > 1000
    assert f"{film}, {message}" in capsys.readouterr().out


@pytest.mark.slow
def test_bench_prints_its_ratios(capsys: Output) -> None:
    assert run("bench", "control", "--steps", "2", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    for key in (
        "controller_over_simulation",
        "tick_over_simulation",
        "env_steps_per_second",
    ):
        assert np.isfinite(result[key]) and result[key] > 0
    assert result["us"]["tick"]["median"] > result["us"]["controller"]["median"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("demo", "text"), [("arm-reach", "hand"), ("base-turn", "a joint of the arm")]
)
def test_play_shows_the_robots_own_tests(
    demo: str, text: str, tmp_path: Path, capsys: Output
) -> None:
    film = tmp_path / "film.mp4"
    options = ["--fps", "2", "--camera.width", "96", "--camera.height", "64"]
    assert run("play", demo, "--video", str(film), "--seconds", "1", *options) == 0
    assert film.stat().st_size > 1000
    assert text in capsys.readouterr().out
    assert run("play", demo, "--video", str(film), "--overwrite", "--seconds", "0.2",
               "--json", *options) == 0  # fmt: skip
    assert "base_drift" in json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_bench_abuse_reports_every_limit(capsys: Output) -> None:
    assert run("bench", "abuse", "--ticks", "480", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["ticks"] == 480
    assert len(result["worst_excess"]) == 10


@pytest.mark.slow
def test_stdout_of_json_is_nothing_but_json(datasets_home: Path) -> None:
    """Across the process border, where PyBullet's greetings would show."""
    arguments = ["--episodes", "2", "--workers", "2", "--max-steps", "1", "--json"]
    output = subprocess.run(
        [sys.executable, "-m", "marl_mm.cli", "eval", "random", *arguments],
        env={**os.environ, "MINARI_DATASETS_PATH": str(datasets_home)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(output.stdout)[0]["policy"] == "random"
    assert "pybullet" not in output.stderr


@pytest.mark.slow
def test_closed_streams_change_no_exit_code(datasets_home: Path) -> None:
    marl_mm = f"{sys.executable} -m marl_mm datasets"
    for words, code in (("list >&-", 0), ("show nosuch 2>&-", 2)):
        assert subprocess.run(["sh", "-c", f"{marl_mm} {words}"]).returncode == code


def test_a_reader_that_has_gone_ends_the_command_in_silence() -> None:
    """As `head` does; seeds that were not yet trained are no success."""
    reader, writer = os.pipe()
    os.close(reader)
    for word in ("tasks", "--version"):  # rich meets the first one
        words = [sys.executable, "-m", "marl_mm.cli", word]
        child = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE)
        assert child.returncode == 1 and child.stderr == b""
    os.close(writer)


def test_sigterm_ends_a_job_that_ignores_ctrl_c() -> None:
    """As jobs do that a script has started in the background."""
    code = """
import signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
from marl_mm.cli import main
from marl_mm.envs.core import EpisodeCore
push = EpisodeCore.push
def begun(*given):
    print("begun", flush=True)
    EpisodeCore.push = push
    return push(*given)
EpisodeCore.push = begun
sys.exit(main(sys.argv[1:]))
"""
    job = subprocess.Popen(
        [sys.executable, "-c", code, "bench", "abuse", "--ticks", "100000000"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert job.stdout is not None and job.stdout.readline() == "begun\n"
    with pytest.raises(subprocess.TimeoutExpired):
        job.wait(1)
    job.terminate()
    _, complaint = job.communicate(timeout=30)
    assert job.returncode == 130
    assert complaint.strip().endswith("marl-mm: interrupted")
