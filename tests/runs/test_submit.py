"""Submissions: the round trip is equal to the bit, and what was changed is found."""

import json
import pickle
import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

import marl_mm
from marl_mm.algorithms.pretrained import WEIGHTS
from marl_mm.cli import main
from marl_mm.envs.registry import config_dict, make_task
from marl_mm.errors import MarlMmError, OutputExistsError, UsageError
from marl_mm.files import write_json
from marl_mm.received import file_digest
from marl_mm.runs.folder import CONFIG, EVALUATION
from marl_mm.runs.submission import (
    EPISODES,
    MANIFEST,
    described,
    files_of,
    read_run,
    seal,
)
from marl_mm.runs.verify import verification_file

GOALS = 6

pytestmark = pytest.mark.slow

TRAINED: dict[str, Any] = {
    "hidden": (32, 32),
    "batch_size": 64,
    "eval_episodes": 2,
    "curve_episodes": 1,
    "engine": "mujoco",
}

Change = Callable[[Path], None]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seeds that reach most goals, and two that reach none."""
    folder = tmp_path_factory.mktemp("runs")
    for name, updates in (("long", 400), ("short", 1)):
        marl_mm.train(
            "mabc",
            "good-5k",
            out=folder / name,
            seeds=(0, 1),
            updates=updates,
            curve_every=updates,
            **TRAINED,
        )
    return folder


@pytest.fixture(scope="module")
def honest(runs: Path) -> Path:
    folder = runs / "honest"
    marl_mm.submit([runs / "long/1", runs / "long/0"], out=folder, episodes=GOALS)
    return folder


@pytest.fixture
def copy(honest: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(honest, tmp_path / "copy"))


def test_scoring_again_is_equal_to_the_bit(copy: Path) -> None:
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    result = marl_mm.verify(copy, seed=3)
    assert (result.verdict, result.differences) == ("equal to the bit", ())
    assert result.equal == result.scored == result.episodes == 2 * GOALS
    assert {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()} == before
    kept = json.loads(verification_file(copy).read_text())
    assert kept["fingerprint"] == result.fingerprint


def test_a_submission_follows_from_its_runs(honest: Path, runs: Path) -> None:
    """Twice the same bytes, no path of this machine, the weights of the checkpoints."""
    again = runs / "again"
    made = marl_mm.submit([runs / "long/0", runs / "long/1"], out=again, episodes=GOALS)
    for path in (p for p in honest.rglob("*") if p.is_file()):
        assert (again / path.relative_to(honest)).read_bytes() == path.read_bytes()
        assert str(runs).encode() not in path.read_bytes()
        assert str(Path(marl_mm.__file__).parent).encode() not in path.read_bytes()
    own = marl_mm.load_run(runs / "long/0")
    assert made.runs[0].policy.fingerprint == own.policy.fingerprint
    assert [row["return"] for row in own.evaluated.rows] == [
        each.row["return"] for each in made.runs[0].episodes[:2]
    ]
    assert made.manifest["dataset"].keys() == {"id", "fingerprint", "data_sha256"}


def test_little_time_scores_a_part_that_a_seed_repeats(
    runs: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "many"
    made = marl_mm.submit([runs / "short/0"], out=folder, episodes=12)
    results = [marl_mm.verify(folder, minutes=1e-6, seed=1) for _ in range(2)]
    assert [each.scored for each in results] == [10, 10]
    assert results[0].success == results[1].success
    assert results[0].verdict == "equal to the bit"
    assert "time was up after 10 episodes" in results[0].notes[0]
    assert results[0].episodes == made.scores("success").size == 12


# --- Tampering ---------------------------------------------------------------


def edit(path: Path, change: Callable[[Any], Any]) -> None:
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))


def row(number: int, **values: Any) -> Change:
    return lambda folder: edit(
        folder / "0" / EVALUATION, lambda v: v["episodes"][number].update(values)
    )


def in_each(name: str, change: Callable[[Any], Any]) -> Change:
    def tamper(folder: Path) -> None:
        for seed in "01":
            edit(folder / seed / name, change)

    return tamper


def manifest(change: Callable[[Any], Any]) -> Change:
    return lambda folder: edit(folder / MANIFEST, change)


def weights(
    change: Callable[[torch.Tensor], torch.Tensor], last: bool = True
) -> Change:
    """Change weights of seed 0, and their hash in its record."""

    def tamper(folder: Path) -> None:
        path = folder / "0" / WEIGHTS
        tensors = load_file(path)
        names = [name for name in tensors if name.endswith("4.bias") or not last]
        changed = {
            n: change(tensors[n]) for n in names if tensors[n].is_floating_point()
        }
        save_file(tensors | changed, path)
        own_hash(folder)

    return tamper


def own_hash(folder: Path) -> None:
    digest = file_digest(folder / "0" / WEIGHTS, MarlMmError)
    edit(folder / "0" / CONFIG, lambda v: v.update(weights_sha256=digest))


def swapped(folder: Path) -> None:
    """Weights of each seed in the other's folder, with their records."""
    for name in (WEIGHTS, CONFIG):
        one, other = folder / "0" / name, folder / "1" / name
        kept = one.read_bytes()
        one.write_bytes(other.read_bytes())
        other.write_bytes(kept)
    edit(folder / "0" / CONFIG, lambda v: v.update(seed=0))
    edit(folder / "1" / CONFIG, lambda v: v.update(seed=1))


def twice(folder: Path) -> None:
    shutil.rmtree(folder / "1")
    shutil.copytree(folder / "0", folder / "1")
    edit(folder / "1" / CONFIG, lambda v: v.update(seed=1))


def removed(values: Any, number: int = 2) -> None:
    for part in (values.get(k) for k in ("episodes", "sha256", "first_action")):
        if part:
            del part[number]


def without_row(folder: Path) -> None:
    for name in (EVALUATION, EPISODES):
        edit(folder / "0" / name, removed)
        edit(folder / "1" / name, removed)


def invented(folder: Path) -> None:
    """Every goal of seed 0 reached, soon; hashes of nothing."""
    for name in "01":
        edit(
            folder / name / EVALUATION,
            lambda v: [
                r.update({"success": True, "return": r["return"] + 20})
                for r in v["episodes"]
            ],
        )
        edit(
            folder / name / EPISODES,
            lambda v: v.update(sha256=["0" * 64 for _ in v["sha256"]]),
        )


def linked(folder: Path) -> None:
    path = folder / "0" / WEIGHTS
    outside = path.rename(folder.parent / "outside.safetensors")
    path.symlink_to(outside)


def pickled(folder: Path) -> None:
    (folder / "0" / "extra.pkl").write_bytes(pickle.dumps({"a": 1}))


def pickle_for_weights(folder: Path) -> None:
    torch.save({"a": torch.zeros(3)}, folder / "0" / WEIGHTS)
    own_hash(folder)


def truncated(folder: Path) -> None:
    path = folder / "0" / WEIGHTS
    path.write_bytes(path.read_bytes()[:-40])
    own_hash(folder)


def hash_of_another(values: Any) -> None:
    values["sha256"][1] = values["sha256"][0]


def looser(values: Any) -> None:
    values["overrides"]["success_distance"] = 0.5


def longer(values: Any) -> None:
    values["overrides"]["max_steps"] = 40


def other_recipe(values: Any) -> None:
    recipe = {"recipe": "quiet-zone-noisy", "recipe_sha256": "0" * 64}
    values["dataset"] |= recipe


TAMPERING: dict[str, tuple[Change, str]] = {
    "a weight changed": (weights(lambda v: v + 0.5), "did not make these rows"),
    "weights of another seed": (swapped, "did not make these rows"),
    "one seed twice": (twice, "has the weights of"),
    "a NaN weight": (weights(lambda v: v * np.nan), "NaN or infinite"),
    "a weight's type": (weights(lambda v: v.double()), "float64, expected"),
    "a weight's shape": (weights(lambda v: v[:-1].clone()), "is damaged"),
    "weights cut off": (truncated, "is damaged"),
    "a pickle for weights": (pickle_for_weights, "is damaged"),
    "a link for weights": (linked, "no links"),
    "a file added": (pickled, "holds '0/extra.pkl'"),
    "a path out of the folder": (
        manifest(lambda v: v["files"].update({"../x": "0" * 64})),
        "'../x' is not the manifest's file",
    ),
    "a success flipped": (row(0, success=False), "rows of goals 0 do not follow"),
    "a return raised": (row(3, **{"return": 99.0}), "do not follow.*by return"),
    "a row removed": (without_row, "row 2 is not of goal 2"),
    "a row twice": (
        in_each(EVALUATION, lambda v: v["episodes"].__setitem__(1, v["episodes"][0])),
        "row 1 is not of goal 1",
    ),
    "an episode's hash copied": (
        lambda folder: edit(folder / "0" / EPISODES, hash_of_another),
        "episodes of goals 1 are others",
    ),
    "all rows invented": (invented, "return: claimed"),
    "the goals' seed": (
        in_each(EVALUATION, lambda v: v.update(seed=1)),
        "goal 0 of se",
    ),
    "a looser task": (in_each(EVALUATION, looser), "replaces success_distance"),
    "an engine that is none": (
        in_each(
            EVALUATION, lambda v: v.update(overrides={"simulation": {"engine": 1}})
        ),
        "simulation.engine is 1",
    ),
    "endless episodes": (
        in_each(EVALUATION, lambda v: v["overrides"].update(max_steps=10**9)),
        "at most 250",
    ),
    "more steps": (in_each(EVALUATION, longer), "are others, while"),
    "another task": (
        in_each(EVALUATION, lambda v: v.update(task="Gate-v0")),
        "same setting",
    ),
    "a seed's hyper-parameter": (
        lambda folder: edit(folder / "0" / CONFIG, lambda v: v.update(batch_size=9)),
        "another setting",
    ),
    "another recipe": (in_each(CONFIG, other_recipe), "quiet-zone-noisy is another"),
    "no seeds": (manifest(lambda v: v.update(seeds=[])), "expected 1 to 100"),
    "a seed below 0": (manifest(lambda v: v.update(seeds=[-1])), "expected 1 to 100"),
    "no claims": (manifest(lambda v: v.pop("claims")), "claims"),
}
"""What an attacker changes, and what is said of it though all hashes are recomputed."""

CLAIMS: dict[str, tuple[Change, str]] = {
    "a claim raised": (
        manifest(lambda v: v["claims"].update(success=1.5)),
        "claims that success is 1.5",
    ),
    "an interval narrowed": (
        manifest(lambda v: v["claims"].update(success_interval=[0.9, 0.91])),
        "claims that success_interval",
    ),
    "the algorithm's name": (manifest(lambda v: v.update(algorithm="mine")), "'mine'"),
    "the dataset": (
        manifest(lambda v: v["dataset"].update(id="marl_mm/reach/other-v0")),
        "other-v0",
    ),
    "the number of goals": (manifest(lambda v: v["goals"].update(count=900)), "900"),
    "a looser task in the manifest": (
        manifest(lambda v: v["task_config"].update(success_distance=0.5)),
        "success_distance = 0.5",
    ),
    "the engine": (manifest(lambda v: v.update(engine="mujoco 9.9")), "mujoco 9.9"),
}
"""The same for what follows from the seeds' files."""


UNSEALED: dict[str, tuple[Change, str]] = {
    "a version": (manifest(lambda v: v["packages"].update(numpy="1.0")), ""),
    "the machine": (manifest(lambda v: v["machine"].update(processor="Z80")), ""),
    "a seed's updates": (
        in_each(CONFIG, lambda v: v.update(updates=10**6)),
        "",
    ),
}
"""What is found as long as the hashes are not recomputed: no episode depends on it."""


def seal_again(folder: Path, claims: bool = True) -> None:
    """Recompute what an attacker can: claims from the rows, all hashes, fingerprint."""
    values = json.loads((folder / MANIFEST).read_text())
    with suppress(MarlMmError, IndexError):  # it may not even read back
        extra = {k: v for k, v in values["files"].items() if k.startswith("..")}
        values["files"] = files_of(folder, values["seeds"]) | extra
        runs = [read_run(folder / str(seed)) for seed in values["seeds"]]
        if claims and "claims" in values:
            task = make_task(runs[0].evaluation.task, runs[0].evaluation.overrides)
            values |= {**described(runs), "task_config": config_dict(task)}
    write_json(folder / MANIFEST, values | {"fingerprint": seal(values)})


def said_of(folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The only line on stderr about a submission that is refused."""
    assert main(["verify", str(folder), "--workers", "1"]) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert len([line for line in lines if line.startswith("marl-mm: ")]) == 1
    return lines[-1]


@pytest.mark.parametrize("name", [*TAMPERING, *CLAIMS])
def test_tampering_is_found_although_all_hashes_are_recomputed(
    name: str, copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, said = (TAMPERING | CLAIMS)[name]
    change(copy)
    seal_again(copy, claims=name in TAMPERING)
    assert re.search(said, said_of(copy, capsys))


@pytest.mark.parametrize("name", [*TAMPERING, *CLAIMS, *UNSEALED])
def test_tampering_is_found_by_the_hashes_alone(name: str, copy: Path) -> None:
    change, _ = (TAMPERING | CLAIMS | UNSEALED)[name]
    change(copy)
    with pytest.raises(MarlMmError):
        marl_mm.board([copy], out=copy.parent / "board")


def test_another_processors_last_bits_are_equal_within_intervals(copy: Path) -> None:
    """Such as products in another order: weights that differ by 1e-7."""
    weights(lambda v: v * (1 + 2e-7), last=False)(copy)
    seal_again(copy)
    result = marl_mm.verify(copy)
    assert (result.verdict, result.differences) == ("equal within intervals", ())
    assert result.equal == GOALS


# --- Refusals ----------------------------------------------------------------


def test_runs_of_several_settings_are_refused(runs: Path, tmp_path: Path) -> None:
    def refused(*names: str, **options: Any) -> str:
        with pytest.raises(UsageError) as error:
            marl_mm.submit([runs / n for n in names], out=tmp_path / "out", **options)
        assert "\n" not in str(error.value)
        return str(error.value)

    assert "updates = 400 (now 1)" in refused("long/0", "short/1")
    assert "both of seed 0" in refused("long/0", "long/0")
    assert "no run given" in refused()
    assert "is no run" in refused("long")
    assert "`episodes` is 0" in refused("long/0", episodes=0)
    unfinished = shutil.copytree(runs / "long/0", runs / "unfinished")
    (unfinished / EVALUATION).unlink()
    assert "not trained to its end" in refused("unfinished")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten_unasked_and_never_another_folder(
    runs: Path, copy: Path
) -> None:
    with pytest.raises(OutputExistsError):
        marl_mm.submit([runs / "long/0"], out=copy, episodes=2)
    with pytest.raises(UsageError, match=r"has no manifest\.json and is not replaced"):
        marl_mm.submit([runs / "long/0"], out=runs, episodes=2, overwrite=True)
    made = marl_mm.submit([runs / "long/0"], out=copy, episodes=2, overwrite=True)
    assert sorted(path.name for path in copy.iterdir()) == ["0", MANIFEST]
    assert "1 seed:" in repr(made)


def test_a_submission_that_is_stopped_leaves_nothing(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("marl_mm.runs.submit.described", stop)
    with pytest.raises(KeyboardInterrupt):
        marl_mm.submit([runs / "long/0"], out=tmp_path / "out", episodes=2)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ["verify", "nothing"],
        ["verify", "."],
        ["submit", "--out", "x"],
        ["submit", "nothing", "--out", "x"],
        ["board"],
        ["board", "nothing"],
    ],
)
def test_what_makes_no_sense_is_a_usage_error(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_time_that_makes_no_sense_is_a_usage_error(honest: Path) -> None:
    with pytest.raises(UsageError, match="`minutes` is nan"):
        marl_mm.verify(honest, minutes=float("nan"))


def test_python_and_the_commands_do_the_same(
    runs: Path, honest: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["submit", str(runs / "long/0"), str(runs / "long/1"), "--workers", "2"]
    out = tmp_path / "out"
    assert main([*words, "--out", str(out), "--episodes", str(GOALS)]) == 0
    fingerprint = json.loads((honest / MANIFEST).read_text())["fingerprint"]
    assert fingerprint in capsys.readouterr().out
    assert main(["verify", str(out), "--json", "--seed", "5"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(verification_file(out).read_text())
    assert (printed["fingerprint"], printed["seed"]) == (fingerprint, 5)
    assert printed["verdict"] == "equal to the bit"
    assert main(["check", str(out)]) == 0
