"""marl-mm ablate: from nothing to tables and figures, with hardly any training."""

import json
from pathlib import Path

import pytest

from marl_mm.algorithms.pretrained import load_pretrained
from marl_mm.cli import main
from marl_mm.commands import ablate_runs
from marl_mm.errors import CheckpointError, DivergedError
from marl_mm.eval.online import MADE_OF, SETTINGS
from marl_mm.eval.rows import read_rows
from marl_mm.progress import Bar
from marl_mm.runs.online import train_online_run
from marl_mm.runs.training import Online

RESULTS = Path(__file__).resolve().parents[2] / "eval/results/online"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


def ablate(runs: Path, out: Path, target: str, *more: str) -> int:
    words = ["--runs", str(runs), "--out", str(out), "--budget", "smoke"]
    return main(["ablate", target, *words, "--seeds", "0", "--workers", "1", *more])


@pytest.mark.slow
def test_every_target_from_raw_runs(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    compared = ["ddpg", "ddpg-her", "maddpg-her", "ddpg-paper", "ddpg-her-paper"]
    assert ablate(runs, tmp_path, "online", "--settings", *compared) == 0
    assert "| DDPG + HER | Reach-v0 | 1 |" in capsys.readouterr().out
    summary = read_rows(tmp_path / "online-part.csv")
    assert [row["setting"] for row in summary] == compared
    evaluations = read_rows(tmp_path / "evaluations.csv.gz")
    assert len(evaluations) == 5 * 2 * 2  # settings, checkpoints, goals
    made_of = json.loads((tmp_path / MADE_OF).read_text())
    assert {name: config["max_steps"] for name, config in made_of.items()} == (
        dict.fromkeys(compared, 4)
    )
    made_of["ddpg"]["max_steps"] = 25  # rows of a run that was no smoke
    (tmp_path / MADE_OF).write_text(json.dumps(made_of))
    assert ablate(runs, tmp_path, "online", "--settings", "ddpg", "--overwrite") == 2
    assert "made with max_steps = 25 (now 4): name another" in capsys.readouterr().err
    again = ["--settings", "ddpg-her", "--overwrite"]
    assert ablate(runs, tmp_path, "online", *again, "--rows", str(tmp_path)) == 0
    assert read_rows(tmp_path / "evaluations.csv.gz") == evaluations
    trained = {path: path.stat().st_mtime_ns for path in runs.rglob("*")}
    for target, file in (
        ("fig4", "fig4.png"),
        ("fig5", "fig5.png"),
        ("fig6", "fig6.png"),
    ):
        assert ablate(runs, tmp_path, target) == 0
        assert (tmp_path / file).stat().st_size > 5_000
    assert ablate(runs, tmp_path, "pretrained") == 0
    shipped = load_pretrained(tmp_path / "pretrained_agent")
    assert shipped.name == "pretrained"
    assert {path: path.stat().st_mtime_ns for path in runs.rglob("*")} == trained
    capsys.readouterr()
    assert ablate(runs, tmp_path, "fig4") == 2
    assert "exists already" in capsys.readouterr().err
    assert ablate(runs, tmp_path / "x", "fig4", "--budget", "full") == 2
    assert "was made with" in capsys.readouterr().err  # smoke is no result


@pytest.mark.slow
def test_stable_baselines3_and_demonstrations_in_the_same_tables(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ["ddpg-her-demonstrations", "sb3-ddpg-her"]
    assert ablate(runs, tmp_path, "online", "--settings", *settings) == 0
    curves = read_rows(tmp_path / "curves.csv.gz")
    episodes = {
        name: [row["episode"] for row in curves if row["setting"] == name]
        for name in settings
    }
    assert episodes == {name: [8] for name in settings}  # epochs of 4, every second
    metadata = runs / "demonstrations/data/metadata.json"
    metadata.write_text(metadata.read_text().replace('"seed": 0', '"seed": 1'))
    capsys.readouterr()
    assert ablate(runs, tmp_path / "y", "runs", "--settings", settings[0]) == 1
    assert "is damaged" in capsys.readouterr().err


@pytest.mark.slow
def test_the_worth_of_alpha_from_raw_runs(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ablate(runs, tmp_path, "alpha", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert {row["task"] for row in rows} == {"Reach-v0", "SmoothReach-v0"}
    steps = read_rows(tmp_path / "alpha_steps.csv")
    assert {row["direction"] for row in steps} == {"forward", "backward"}
    assert (tmp_path / "alpha.png").exists()


@pytest.mark.slow
def test_a_run_that_diverged_counts_as_it_was_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def diverge(training: Online, seed: int, run: Path, bar: Bar) -> None:
        train_online_run(training, seed, run, bar)
        (run / "eval.json").unlink()
        (run / "eval_best.json").unlink()
        raise DivergedError("loss/critic is nan")

    monkeypatch.setattr(ablate_runs, "train_online_run", diverge)
    assert ablate(tmp_path, tmp_path, "online", "--settings", "ddpg") == 0
    assert "loss/critic is nan; it counts as it is" in capsys.readouterr().err
    assert ablate(tmp_path, tmp_path, "runs", "--settings", "ddpg") == 0


@pytest.mark.slow
def test_a_run_that_fails_does_not_stop_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(training: Online, seed: int, run: Path, bar: Bar) -> None:
        if run.parent.name == "ddpg":
            raise CheckpointError("the disk is full")
        train_online_run(training, seed, run, bar)

    names = ["--settings", "ddpg", "ddpg-her"]
    with monkeypatch.context() as patch:
        patch.setattr(ablate_runs, "train_online_run", fail)
        assert ablate(tmp_path, tmp_path, "runs", *names) == 1
    told = capsys.readouterr().err
    assert "1 of 2 runs failed, the same command tries them again" in told
    assert "the disk is full" in told
    assert ablate(tmp_path, tmp_path, "runs", *names, "--plan") == 0
    assert "1 of 2 online runs" in capsys.readouterr().out
    assert ablate(tmp_path, tmp_path, "online", *names, "--resume") == 0
    assert ablate(tmp_path, tmp_path, "online", *names) == 2
    assert ablate(tmp_path, tmp_path, "online", *names, "--resume") == 0


def test_settings_are_named_once_and_unknown_ones_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len({setting.name for setting in SETTINGS}) == len(SETTINGS)
    assert ablate(tmp_path, tmp_path, "online", "--settings", "ddgp") == 2
    assert "no setting 'ddgp': expected ddpg, ddpg-her" in capsys.readouterr().err
    assert ablate(tmp_path, tmp_path, "online", "--settings") == 2
    assert "--settings is empty: expected ddpg, " in capsys.readouterr().err
    assert ablate(tmp_path, tmp_path, "fig4", "--settings", "ddpg") == 2
    assert "--settings is for runs and online" in capsys.readouterr().err


@pytest.mark.parametrize("target", ["online", "alpha"])
def test_what_is_committed_is_drawn_from_its_rows(
    target: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """If this fails: marl-mm ablate TARGET --rows RESULTS --out RESULTS --overwrite."""
    assert main(["ablate", target, "--out", str(RESULTS), "--check"]) == 0
    assert "the same" in capsys.readouterr().out


def test_rows_that_are_not_there_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for target, file in (("online", "curves.csv.gz"), ("alpha", "alpha_goals.csv.gz")):
        assert main(["ablate", target, "--out", str(tmp_path), "--check"]) == 2
        assert f"{file} to draw from" in capsys.readouterr().err
    assert main(["ablate", "runs", "--check"]) == 2
    assert "--check is for tables, and runs has none" in capsys.readouterr().err
