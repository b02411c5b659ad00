"""Hostile files: mutations of good ones are refused in one line, or do no harm.

The usual test run tries 320 of them, ``pytest -m fuzz`` 5,000 others.
"""

import io
import json
import os
import shutil
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import marl_mm
from marl_mm.algorithms import pretrained
from marl_mm.algorithms.checkpoint import FILE
from marl_mm.algorithms.export import export_policy
from marl_mm.algorithms.policy import load_policy
from marl_mm.cli import main
from marl_mm.contracts import fuzz
from marl_mm.contracts.files import fingerprint
from marl_mm.contracts.fuzz import trials
from marl_mm.contracts.mutations import mutate
from marl_mm.datasets.journal import Journal
from marl_mm.errors import CheckpointError, DatasetError, MarlMmError
from marl_mm.eval.rows import write_csv
from marl_mm.eval.studies.study import cell_name
from marl_mm.eval.studies.targets import STUDIES
from marl_mm.received import is_printable

SHARES = {
    "dataset": 0.25,
    "offline/0": 0.2,
    "online/0": 0.15,
    "journal": 0.12,
    "shipped": 0.08,
    "policy.ts": 0.08,
    "policy.onnx": 0.04,
    "rows.csv.xz": 0.08,
}
"""Shares of the mutations, by what is changed."""

USUAL, ALL = 160, 5_000
"""Number of mutations in the usual test run, and alone."""

CHUNK = 40
"""Number of mutations in a test."""

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "eval/results/studies"

Output = pytest.CaptureFixture[str]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "chunk" in metafunc.fixturenames:
        alone = metafunc.config.getoption("markexpr") == "fuzz"
        chunks = [
            (name, begin, min(CHUNK, count - begin))
            for name, share in SHARES.items()
            for count in [round(share * (ALL if alone else USUAL))]
            for begin in range(0, count, CHUNK)
        ]
        names = [f"{name}-{begin}" for name, begin, _ in chunks]
        seeded = [(*chunk, int(alone)) for chunk in chunks]
        metafunc.parametrize("chunk", seeded, ids=names)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of every kind, as the commands write them."""
    folder = tmp_path_factory.mktemp("good")
    few: dict[str, Any] = {"steps": 40, "max_steps": 10, "engine": "mujoco"}
    data = marl_mm.collect("pd", seed=3, dataset=folder / "dataset", **few)
    with Journal(folder / "journal") as journal:
        journal.begin({**data.provenance.own_origin.to_json(), "steps_asked": 40})
        for episode in data.episodes:
            journal.add(episode)
    small: dict[str, Any] = {
        "hidden": (16, 16),
        "eval_episodes": 2,
        "curve_episodes": 2,
    }
    small |= {"max_steps": 4, "engine": "mujoco"}
    marl_mm.train(
        "mabc", data, out=folder / "offline", updates=20, curve_every=20, **small
    )
    marl_mm.train(
        "maddpg-her",
        out=folder / "online",
        episodes=4,
        warm_up=8,
        updates_per_episode=2,
        **small,
    )
    policy = load_policy(folder / "offline/0")
    export_policy(policy, folder / "policy.ts", "torchscript")
    export_policy(policy, folder / "policy.onnx", "onnx")
    pretrained.ship(folder / "online/0", folder / "shipped")
    rng = np.random.default_rng(0)
    rows = [
        {"seed": 0, "probe": "last", "goal": n, "return": float(rng.normal())}
        for n in range(50)
    ]
    write_csv(folder / "rows.csv.xz", rows)
    results = folder / "studies"
    study = STUDIES["table4"]
    for source, setting in map(cell_name, study.cells):
        place = Path("rows", source.replace("/", "-"))
        (results / place).mkdir(parents=True, exist_ok=True)
        for file in (RESULTS / place).glob(f"{setting}.*"):
            shutil.copy(file, results / place)
    shutil.copy(RESULTS / "table4.csv", results)
    return folder


@pytest.mark.slow
@pytest.mark.fuzz
def test_mutations_are_refused_or_harmless(
    good: Path, chunk: tuple[str, int, int, int]
) -> None:
    name, begin, count, seed = chunk
    tried = list(trials(good / name, count, seed, begin))
    assert [trial for trial in tried if trial.broken] == []
    assert any(trial.outcome == "refused" for trial in tried)


def commands(path: Path, scratch: Path) -> list[str]:
    """Faults in what commands say of a file."""
    words = {
        "dataset": [
            ["datasets", "show", str(path)],
            ["datasets", "filter", str(path), "--outcome", "reached", "--out"],
        ],
        "0": [
            ["eval", str(path), "--episodes", "1", "--max-steps", "2"],
            ["runs", str(path.parent)],
            ["export", str(path), "--out", str(scratch / "policy.ts")],
        ],
        "studies": [["ablate", "table4", "--check", "--out", str(path)]],
    }[path.name]
    faults = []
    for number, command in enumerate(words):
        if command[-1] == "--out":
            command.append(str(scratch / f"new-{number}"))
        told, said = io.StringIO(), io.StringIO()
        with redirect_stderr(told), redirect_stdout(said):
            code = main(command)
        complaint = told.getvalue().strip().rpartition("\n")[2]
        if code not in (0, 1, 2):
            faults.append(f"{command}: exit code {code}")
        if code and not complaint.startswith("marl-mm: "):
            faults.append(f"{command}: {complaint}")
        if not is_printable(said.getvalue() + complaint):
            faults.append(f"{command}: control characters")
    return faults


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dataset", "offline/0", "studies"])
def test_commands_meet_mutations_with_a_line(
    good: Path, tmp_path: Path, name: str
) -> None:
    for number in range(10):
        copy = tmp_path / str(number) / Path(name).name
        shutil.copytree(good / name, copy)
        about = mutate(copy, np.random.default_rng([7, number])).about
        scratch = tmp_path / f"out-{number}"
        scratch.mkdir()
        assert commands(copy, scratch) == [], about


def test_rows_with_an_empty_line_and_empty_files_can_be_mutated(tmp_path: Path) -> None:
    for number in range(60):
        folder = tmp_path / str(number)  # a link may lie in the others
        folder.mkdir()
        (folder / "rows.csv").write_text("a,b\n\n1,2\n")
        (folder / "more.csv").write_text("")
        assert "more" not in mutate(folder, np.random.default_rng(number)).about


# --- Checkpoints -------------------------------------------------------------


@pytest.mark.slow
def test_no_flipped_bit_of_a_checkpoint_goes_unnoticed(
    good: Path, tmp_path: Path
) -> None:
    content = (good / "offline/0" / FILE).read_bytes()
    path = tmp_path / FILE
    path.write_bytes(content)
    whole = fingerprint(path)
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(200):
        flipped = bytearray(content)
        flipped[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        path.write_bytes(flipped)
        try:
            assert fingerprint(path) == whole
        except CheckpointError:
            refused += 1
    assert refused > 100


def resave(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    contents = torch.load(path, weights_only=True)
    change(contents)
    with path.open("wb") as file:
        torch.save(contents, file)


def first_weight(contents: dict[str, Any]) -> tuple[dict[str, Any], str]:
    actor = next(iter(contents["state"]["actors"].values()))
    return actor, "layers.0.weight"


def put(contents: dict[str, Any], value: torch.Tensor) -> None:
    actor, key = first_weight(contents)
    actor[key] = value


def nested(contents: dict[str, Any]) -> None:
    value: list[Any] = []
    for _ in range(40):
        value = [value, value]
    contents["config"]["x"] = value


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda c: put(c, torch.full((16, 9), torch.nan)), "NaN or infinite"),
        (lambda c: put(c, torch.zeros(1).expand(10**12)), "with less data"),
        (lambda c: put(c, torch.zeros(10**9, 0)), "an empty tensor"),
        (lambda c: put(c, torch.zeros(16, 9).to_sparse()), "sparse"),
        (nested, "more than"),
        (lambda c: c.update(algorithm="\x1b[31m"), "control characters"),
        (lambda c: c.update(state=[]), "state"),
        (lambda c: c["state"].pop("actors"), "'actors'"),
        (
            lambda c: next(iter(c["state"]["actors"].values()))[
                "normalizer.std"
            ].neg_(),
            "not > 0",
        ),
    ],
)
def test_checkpoints_that_would_do_harm_are_refused(
    good: Path,
    tmp_path: Path,
    capsys: Output,
    change: Callable[[dict[str, Any]], object],
    match: str,
) -> None:
    path = tmp_path / FILE
    shutil.copy(good / "offline/0" / FILE, path)
    resave(path, change)
    assert main(["eval", str(path), "--episodes", "2"]) == 1
    error = capsys.readouterr().err
    assert match in error and error.count("\n") == 1


class Called:
    """An object whose pickle calls a function."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("called",)


@pytest.mark.parametrize("protocol", [2, 4])
def test_a_pickled_object_is_refused_in_one_line(
    tmp_path: Path, capsys: Output, monkeypatch: pytest.MonkeyPatch, protocol: int
) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"state": Called()}, FILE, pickle_protocol=protocol)
    assert main(["eval", FILE, "--episodes", "2"]) == 1
    error = capsys.readouterr().err
    reason = {2: "other Python objects than numbers", 4: "a pickle of protocol 4"}
    assert reason[protocol] in error and error.count("\n") == 1
    assert not Path("called").exists()


@pytest.mark.slow
def test_a_dataset_that_is_a_package_too_is_only_read(
    good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Output
) -> None:
    """By a plain word, which may also be the name of a module."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    shutil.copytree(good / "dataset", "stranger")
    Path("stranger/__init__.py").write_text("import os; os.mkdir('called')")
    assert main(["check", "stranger"]) == 0, capsys.readouterr().out
    assert not Path("called").exists()


@pytest.mark.slow
@pytest.mark.parametrize("key", ["step", "actors", "actor_learners", "batches"])
def test_a_run_whose_checkpoint_lacks_a_part_is_not_resumed(
    good: Path, tmp_path: Path, capsys: Output, key: str
) -> None:
    shutil.copytree(good / "offline", tmp_path / "offline")
    run = tmp_path / "offline/0"
    (run / "eval.json").unlink()
    resave(run / FILE, lambda contents: contents["state"].pop(key))
    config = json.loads((run / "config.json").read_text())
    words = ["train", "mabc", "--dataset", config["dataset"]["path"], "--resume"]
    assert main([*words, "--out", str(tmp_path / "offline"), "--updates", "40"]) == 1
    error = capsys.readouterr().err
    assert "is damaged" in error and error.strip().count("\nmarl-mm") == 0


@pytest.mark.slow
def test_records_of_a_run_are_no_links_out_of_it(
    good: Path, tmp_path: Path, capsys: Output
) -> None:
    run = Path(shutil.copytree(good / "offline/0", tmp_path / "run"))
    for name in ("eval.json", "config.json"):
        (run / name).rename(tmp_path / name)
        (run / name).symlink_to(tmp_path / name)
        with pytest.raises(CheckpointError, match=f"{name} is a link out of its fold"):
            _ = marl_mm.load_run(run).evaluation, marl_mm.load_run(run).config
        assert main(["check", str(run)]) == 1
        assert "is a link out of its folder" in capsys.readouterr().out
        (run / name).unlink()
        (tmp_path / name).rename(run / name)


@pytest.mark.slow
def test_what_eval_writes_is_a_record(
    good: Path, tmp_path: Path, capsys: Output
) -> None:
    run = Path(shutil.copytree(good / "offline/0", tmp_path / "run"))
    rows = run / "eval_two.json"
    few = ["--episodes", "2", "--max-steps", "2", "--out", str(rows)]
    assert main(["eval", str(run), "random", *few]) == 0
    assert main(["check", str(rows)]) == main(["check", str(run)]) == 0
    rows.write_text(rows.read_text().replace('"success"', '"succes"'))
    capsys.readouterr()
    assert main(["check", str(rows)]) == 1
    assert "lacks 'success'" in capsys.readouterr().out


def test_the_shipped_agents_weights_have_a_hash(good: Path, tmp_path: Path) -> None:
    copy = tmp_path / "agent"
    shutil.copytree(good / "shipped", copy)
    path = copy / pretrained.WEIGHTS
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="not those that were written"):
        load_policy(copy)
    load_policy("pretrained")


@pytest.mark.slow
def test_a_run_with_metrics_and_no_checkpoint_is_not_whole(
    good: Path,
    tmp_path: Path,
) -> None:
    run = Path(shutil.copytree(good / "offline/0", tmp_path / "run"))
    fingerprint(run)
    (run / FILE).unlink()
    with pytest.raises(CheckpointError, match=f"has metrics, but no {FILE}"):
        fingerprint(run)


@pytest.mark.slow
def test_a_journal_of_longer_episodes_than_its_tasks_is_not_whole(
    good: Path,
    tmp_path: Path,
) -> None:
    data = marl_mm.load_dataset(good / "dataset")
    longest = int(data.arrays.lengths.max())
    with Journal(tmp_path / "journal") as journal:
        about = data.provenance.own_origin.to_json()
        about["overrides"] = {**about["overrides"], "max_steps": longest - 1}
        journal.begin({**about, "steps_asked": 40})
        for episode in data.episodes:
            journal.add(episode)
    with pytest.raises(DatasetError, match=f"{longest} steps, at most {longest - 1}"):
        fingerprint(tmp_path / "journal")


def accepts(path: Path) -> tuple[str, str]:
    """Finds something else in any file, and nothing wrong with it."""
    return "accepted", "something else"


def spoils(path: Path) -> tuple[str, str]:
    """Leaves a file behind."""
    (path.parent / "left").touch()
    return "accepted", "something else"


def ends(path: Path) -> tuple[str, str]:
    """Takes its process along."""
    os._exit(3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("read", "outcome"),
    [
        (accepts, "damage accepted"),
        (spoils, "changed file"),
        (ends, "crash or hang"),
    ],
)
def test_trials_find_what_a_reader_must_not_do(
    read: Callable[[Path], tuple[str, str]],
    outcome: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "rows.csv.xz"
    write_csv(path, [{"seed": seed, "return": 0.5} for seed in range(9)])
    monkeypatch.syspath_prepend(ROOT)  # workers import this file
    monkeypatch.setattr(fuzz, "_read", read)
    found = {trial.outcome: trial.broken for trial in trials(path, 4, seed=0)}
    assert found[outcome] and not found.get("accepted")


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (ValueError("odd"), "traceback"),
        (MarlMmError("two\nlines"), "error of several lines"),
        (MarlMmError("a line"), "refused"),
    ],
)
def test_only_a_line_of_the_package_is_a_refusal(
    error: Exception, outcome: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> str:
        raise error

    monkeypatch.setattr(fuzz, "fingerprint", refuse)
    assert fuzz._read(Path("any"))[0] == outcome
    assert fuzz.Trial(0, "", outcome).broken == (outcome != "refused")
