"""marl-mm ablate: from nothing to tables and figures, with hardly any training."""

import json
from pathlib import Path

import pytest

from marl_mm.cli import main
from marl_mm.errors import DivergedError
from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies.learners import Learner, training_of
from marl_mm.eval.studies.settings import BEST, LAST, Setting
from marl_mm.eval.studies.settings import Online as StudyOnline
from marl_mm.eval.studies.targets import GROUPS, STUDIES
from marl_mm.progress import Bar, silent_bar
from marl_mm.runs import learning
from marl_mm.runs.learning import train_run
from marl_mm.runs.training import Training

RESULTS = Path(__file__).resolve().parents[2] / "eval/results/studies"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


def ablate(runs: Path, out: Path, target: str, *more: str) -> int:
    words = ["--runs", str(runs), "--out", str(out), "--budget", "smoke"]
    words += ["--engine", "mujoco"]  # the faster one
    return main(["ablate", target, *words, "--seeds", "0", "--workers", "1", *more])


@pytest.mark.slow
def test_online_targets_from_raw_runs(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    compared = ["ddpg", "ddpg-her", "maddpg-her", "ddpg-paper", "ddpg-her-paper"]
    assert ablate(runs, tmp_path, "online", "--settings", *compared) == 0
    assert "| DDPG + HER | Reach-v0 | mujoco 4.0.0 | 1 |" in capsys.readouterr().out
    summary = read_rows(tmp_path / "online-part.csv")
    assert [row["setting"] for row in summary] == compared
    cell = tmp_path / "rows/online-Reach-v0/ddpg"
    assert len(read_rows(cell.with_suffix(".csv.xz"))) == 2 * 2  # probes, goals
    record = cell.with_suffix(".json")
    made_of = json.loads(record.read_text())
    assert made_of["max_steps"] == 4
    record.write_text(json.dumps(made_of | {"max_steps": 25}))  # of no smoke
    assert ablate(runs, tmp_path, "online", "--settings", "ddpg", "--overwrite") == 2
    assert "made with max_steps = 25 (now 4): name another" in capsys.readouterr().err
    record.write_text(json.dumps(made_of))
    trained = {path: path.stat().st_mtime_ns for path in runs.rglob("*")}
    assert ablate(runs, tmp_path, "fig4") == 0
    assert ablate(runs, tmp_path, "fig5") == 0
    for number in (4, 5):
        assert (tmp_path / f"fig{number}.png").stat().st_size > 5_000
    assert {path: path.stat().st_mtime_ns for path in runs.rglob("*")} == trained
    capsys.readouterr()
    assert ablate(runs, tmp_path, "fig4") == 2
    assert "exists already" in capsys.readouterr().err
    assert ablate(runs, tmp_path / "x", "fig4", "--budget", "full") == 2
    assert "was made with" in capsys.readouterr().err  # smoke is no result


@pytest.mark.slow
def test_stable_baselines3_and_demonstrations_in_the_same_table(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ["ddpg-her-demonstrations", "sb3-ddpg-her"]
    assert ablate(runs, tmp_path, "online", "--settings", *settings) == 0
    for path in tmp_path.glob("rows/*/*.curve.csv.xz"):  # epochs of 4, every second
        assert [row["episode"] for row in read_rows(path)] == [8]
    assert len(read_rows(tmp_path / "online-part.csv")) == 2
    (metadata,) = (runs / "datasets").glob("demonstrations*/data/metadata.json")
    metadata.write_text(metadata.read_text().replace('"seed": 0', '"seed": 1'))
    capsys.readouterr()
    assert ablate(runs, tmp_path / "y", "online", "--settings", settings[0]) == 1
    assert "is damaged" in capsys.readouterr().err


@pytest.mark.slow
def test_the_worth_of_alpha_from_raw_runs(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ablate(runs, tmp_path, "alpha") == 0
    assert "| agent | task | seed |" in capsys.readouterr().out
    rows = read_rows(tmp_path / "alpha_worth.csv")
    assert {row["task"] for row in rows} == {"Reach-v0", "SmoothReach-v0"}
    steps = read_rows(tmp_path / "alpha_steps.csv")
    assert {row["direction"] for row in steps} == {"forward", "backward"}
    assert (tmp_path / "alpha.png").exists()
    assert ablate(runs, tmp_path, "alpha", "--check") == 0
    assert "alpha_worth.csv: the same" in capsys.readouterr().out
    made = (tmp_path / "alpha_goals.csv.xz").read_bytes()
    kept = {file: file.stat().st_mtime_ns for file in (runs / "alpha").iterdir()}
    missing = min(kept)
    missing.unlink()
    assert ablate(runs, tmp_path, "alpha", "--resume") == 0
    new = {file for file, at in kept.items() if file.stat().st_mtime_ns != at}
    assert new == {missing} and len(kept) == 3 * 4  # agents, alphas
    assert (tmp_path / "alpha_goals.csv.xz").read_bytes() == made


def _diverge(training: Training, data: None, seed: int, run: Path, bar: Bar) -> None:
    train_run(training, data, seed, run, bar)
    (run / "eval.json").unlink()
    (run / "eval_best.json").unlink()
    raise DivergedError("loss/critic is nan")


@pytest.mark.slow
def test_a_run_that_diverged_counts_as_it_was_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learning, "train_run", _diverge)
    small = training_of(StudyOnline(), Setting("x", "x", "ddpg"), None, small=True)
    learner = Learner(small, None)
    learner.train({0: tmp_path / "run"}, silent_bar)
    assert all(probe.file(tmp_path / "run").exists() for probe in (LAST, BEST))


def test_settings_are_named_once_and_unknown_ones_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ablate(tmp_path, tmp_path, "online", "--settings", "ddgp") == 2
    assert "--settings has no 'ddgp': expected ddpg, " in capsys.readouterr().err
    assert ablate(tmp_path, tmp_path, "online", "--settings") == 2
    assert "--settings is empty: expected ddpg, " in capsys.readouterr().err
    assert ablate(tmp_path, tmp_path, "alpha", "--settings", "ddpg") == 2
    assert "--settings are for a study, not alpha" in capsys.readouterr().err
    assert ablate(tmp_path, tmp_path, "robustness", "--settings", "robust-bc") == 2
    assert "--settings are for a study, not robustness" in capsys.readouterr().err


@pytest.mark.slow
def test_what_is_committed_is_drawn_from_its_rows(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """If this fails: marl-mm ablate TARGET --out RESULTS --overwrite."""
    assert main(["ablate", "all", "--check"]) == 0
    states = [line.rpartition(": ") for line in capsys.readouterr().out.splitlines()]
    assert {state for _, _, state in states} == {"the same"}
    checked = {Path(path).stem for path, _, _ in states}
    studies = {name for name in GROUPS["all"] if name in STUDIES}
    assert checked >= {*studies, "alpha_worth", "alpha", "worth", "loads"}


def test_rows_that_are_not_there_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for target, file in (("online", "ddpg.csv.xz"), ("alpha", "alpha_goals.csv.xz")):
        assert main(["ablate", target, "--out", str(tmp_path), "--check"]) == 2
        assert file in capsys.readouterr().err
