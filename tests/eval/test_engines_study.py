"""Both engines beside each other: by hand, and from nothing to tables in small."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from marl_mm import plugins
from marl_mm.algorithms.run_config import RunConfig
from marl_mm.cli import main
from marl_mm.errors import UsageError
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies import figures
from marl_mm.eval.studies.cells import kept_rows, run_cells
from marl_mm.eval.studies.engines import (
    TRANSFER,
    EnginesOptions,
    contestants,
    recorded,
)
from marl_mm.eval.studies.engines_summary import (
    MEASURES,
    agreement,
    mean_maximum_rank_violation,
    paired,
    pearson,
)
from marl_mm.eval.studies.offline import STUDIES
from marl_mm.eval.studies.options import StudyOptions
from marl_mm.eval.studies.policies import Contestant, PolicyCell, run_cell
from marl_mm.eval.studies.study import cell_name
from marl_mm.progress import silent_bar
from marl_mm.sim.config import Engine

RESULTS = Path(__file__).resolve().parents[2] / "eval" / "results" / "studies"

MUJOCO = {"simulation": {"engine": "mujoco"}}

OWN = """
from marl_mm.eval.studies import LAST, Probe, Setting, Source, Study

FEW = {"updates": 40, "hidden": (8, 8)}
SETTING = Setting("few", "few", changes=FEW, goals=2, curve_goals=2)
ONE = Study("On the engine asked for.", [(Source(steps=30, name="own"), SETTING)])
SHIPPED = Study("Of the data that ship.", [("good-5k", SETTING)])
OTHER = Probe("other", "on MuJoCo", overrides={"simulation": {"engine": "mujoco"}})
SLIPPERY = Probe("slips", "", overrides={"simulation": {"wheel_friction": 0.2}})
SLIPS = Study("Probed.", [(Source(steps=30, name="own"), SETTING)], (SLIPPERY,))
BOTH = Study("By name.", [(Source(steps=30, engine="bullet"), SETTING)], (LAST, OTHER))
"""


def test_rank_violations_by_hand() -> None:
    """The pair (0, 1) has another order: by 0.1 for both, and the third has none."""
    reference, other = np.array([0.5, 0.6, 0.9]), np.array([0.6, 0.5, 0.9])
    assert mean_maximum_rank_violation(reference, other) == pytest.approx(0.2 / 3)
    assert mean_maximum_rank_violation(reference, reference) == 0.0
    assert mean_maximum_rank_violation(reference, 1 - reference) == pytest.approx(
        (0.4 + 0.3 + 0.4) / 3
    )
    assert pearson(reference, 2 * reference + 1) == pytest.approx(1.0)
    assert np.isnan(pearson(reference, np.ones(3)))


def rows_of(policy: str, engine: str, returns: list[float]) -> list[Row]:
    same = dict.fromkeys(MEASURES, 1.0)
    about = {"policy": policy, "engine": engine, "seed": 0}
    return [
        {**about, "goal": goal, **same, "return": value}
        for goal, value in enumerate(returns)
    ]


def test_differences_are_paired_by_goal() -> None:
    rows = [
        *rows_of("a", "bullet 1", [1.0, 3.0]),
        *rows_of("a", "mujoco 2", [1.5, 3.5])[::-1],
        *rows_of("b", "bullet 1", [0.0, 0.0]),
        *rows_of("b", "mujoco 2", [0.0, 0.0]),
    ]
    first, second = paired("Reach-v0", rows)
    assert (first["engine"], first["beside"]) == ("bullet 1", "mujoco 2")
    assert (first["return"], first["return_beside"]) == (2.0, 2.5)
    assert first["return_difference"] == 0.5
    assert first["return_difference_interval"] == (0.5, 0.5)
    assert second["return_difference"] == 0.0
    success, by_return = agreement([first, second])
    assert success["measure"] == "success" and np.isnan(success["pearson"])
    assert by_return["pearson"] == pytest.approx(1.0) and by_return["mmrv"] == 0.0


def test_every_task_has_twenty_policies() -> None:
    for task in ("Reach-v0", "PreciseReach-v0", "GraspReach-v0"):
        policies = contestants(task, EnginesOptions())
        names = [policy.name for policy in policies]
        assert len(names) == len(set(names)) >= 20
        for policy in policies:
            assert policy.policy(task, {}).describe() is not None


def begun(run: Path, engine: Engine) -> Path:
    """A run that ``contestants`` finds."""
    run.mkdir(parents=True)
    (run / "checkpoint.pt").touch()
    config = RunConfig(algorithm="mabc", seed=0, task="Reach-v0", engine=engine)
    (run / "config.json").write_text(json.dumps(config.to_json()))
    return run


def test_agents_whose_runs_are_there_take_part(tmp_path: Path) -> None:
    options = EnginesOptions(runs=tmp_path)
    run = begun(options.run_folder(TRANSFER.cells[0], 0), "bullet")
    *_, agent = contestants("SmoothReach-v0", options)
    assert agent.name == "mabc-good-10k-bullet"
    assert agent.settings == (("agent", str(run)),)
    cell = recorded(PolicyCell("SmoothReach-v0", "bullet", agent, 2))
    assert cell.contestant.settings == (("agent", "good-10k-bullet/mabc/0"),)


@pytest.mark.parametrize("engine", ["bullet", "mujoco"])
def test_agents_that_grasp_take_part_in_their_own_task(
    tmp_path: Path, engine: Engine
) -> None:
    made = StudyOptions(runs=tmp_path, engine=engine)
    cell = next(c for c in STUDIES["blocks"].cells if "/grasp/" in cell_name(c)[0])
    begun(made.run_folder(cell, 0), engine)
    options = EnginesOptions(runs=tmp_path)
    *_, agent = contestants("Grasp-v0", options)
    assert agent.name == f"mabc-scripted-20k-{engine}"
    assert len(contestants("GraspReach-v0", options)) == 21


def test_kept_rows_are_of_the_plug_in_that_made_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = [PolicyCell("Reach-v0", "mujoco", Contestant("random", "random"), 1, 1)]
    run_cells(run_cell, cells, tmp_path, 1, (silent_bar, "x"))
    assert [*kept_rows(cells, tmp_path)] == cells
    monkeypatch.setattr(plugins, "record", lambda *origins: {"mine.py": "another"})
    assert not kept_rows(cells, tmp_path)


def test_a_plan_counts_teams(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["ablate", "coordination", "--plan", "--tasks", "Bar-v0", "Reach-v0"]
    assert main([*asked, "--runs", str(tmp_path / "runs")]) == 0
    text = capsys.readouterr().out
    for task, number in (("Bar-v0", 26), ("Bar-hard-v0", 4), ("Reach-v0", 19)):
        assert f"| {task} | mujoco | {number} of {number} |" in text
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("coordination --seeds 0", "--seeds are of trained runs: teams have none"),
        ("coordination --precision highest", "--precision is highest, expected auto"),
        ("engines --precision highest", "--precision is highest, expected auto"),
        ("tuning --engine bullet", "--engine is bullet, expected mujoco"),
        ("tuning --data gate-expert gate-expert", "gate-expert is named twice"),
    ],
)
@pytest.mark.bullet
def test_options_that_would_change_nothing_are_refused(
    words: str, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ablate", *words.split()]) == 2
    assert complaint in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (
            ["coordination", "--tasks", "Gate-v0"],
            "Gate-v0.json was made with goals =",
        ),
        (
            ["tuning", "--algorithms", "bc"],
            "bc.json was made with dataset = quiet",
        ),
        (["engines", "--tasks", "Reach-v0"], "Reach-v0.json was made with goals = 200"),
    ],
)
@pytest.mark.bullet
def test_rows_of_other_settings_are_not_replaced(
    words: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Although tables are drawn again with --resume."""
    shutil.copytree(RESULTS / "rows" / words[0], tmp_path / "rows" / words[0])
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    asked = ["ablate", *words, "--budget", "smoke", "--runs", str(tmp_path / "runs")]
    assert main([*asked, "--out", str(tmp_path), "--resume"]) == 2
    assert complaint in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*")} == before


@pytest.mark.bullet
def test_a_plan_counts_policies_and_runs_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Hours are in proportion to goals, and in inverse to workers."""

    def lines(*words: str) -> list[list[str]]:
        asked = ["ablate", "engines", "--plan", "--tasks", "Reach-v0", "--runs"]
        assert main([*asked, str(tmp_path / "runs"), *words]) == 0
        text = capsys.readouterr().out.strip().splitlines()
        assert not (tmp_path / "runs").exists()
        return [[word.strip() for word in line.split("|")[1:-1]] for line in text]

    head, _, bullet, mujoco, every = lines("--goals", "20000", "--workers", "1")
    assert head[2:] == ["missing", "hours at most, 1 at once"]
    assert (bullet[:3], mujoco[:3]) == (
        ["Reach-v0", "bullet", "24 of 24"],
        ["Reach-v0", "mujoco", "24 of 24"],
    )
    assert every[:3] == ["all", "", "48 of 48"]
    assert float(every[3]) == pytest.approx(float(bullet[3]) + float(mujoco[3]), 0.01)
    assert float(bullet[3]) > 2 * float(mujoco[3])
    head, _, fewer, *_ = lines("--goals", "5000", "--workers", "2")
    assert head[3] == "hours at most, 2 at once"
    assert float(fewer[3]) == pytest.approx(float(bullet[3]) / 8, 0.5)
    *_, small = lines("--budget", "smoke")
    assert small == ["all", "", "6 of 6"]  # nothing is timed


def test_a_figure_has_a_panel_per_task_and_a_point_per_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(
        figures, "save_small", lambda figure, path: drawn.append(figure)
    )
    shares = {"pd-kp2": (0.5, 0.6), "pd-kp5": (1.0, 0.9), "random": (0.0, 0.0)}
    about = {"engine": "bullet 1", "beside": "mujoco 2"}
    summary: list[Row] = [
        {"task": task, "policy": name, **about, "success": one, "success_beside": other}
        for task in ("Reach-v0", "Grasp-v0", "CarryReach-v0", "GraspReach-v0")
        for name, (one, other) in shares.items()
    ]
    figures.engines_figure(summary, tmp_path / "engines.png")
    (figure,) = drawn
    titles = [axis.get_title() for axis in figure.axes]
    assert titles == ["Reach-v0", "Grasp-v0", "CarryReach-v0", "GraspReach-v0"]
    for axis in figure.axes:
        equal, *kinds = axis.lines
        points = {
            str(k.get_label()): np.asarray(k.get_xydata()).tolist() for k in kinds
        }
        assert np.asarray(equal.get_xydata()).tolist() == [[0, 0], [100, 100]]
        assert points == {"pd": [[50, 60], [100, 90]], "random": [[0, 0]]}


@pytest.mark.slow
def test_engines_from_nothing_to_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["ablate", "engines", "--budget", "smoke", "--tasks", "Reach-v0"]
    runs = ["--runs", str(tmp_path), "--workers", "1"]
    assert main([*words, *runs]) == 0
    assert "mujoco 4" in capsys.readouterr().out
    results = tmp_path / "results"
    summary = read_rows(results / "engines.csv")
    assert {row["task"] for row in summary} == {"Reach-v0"}
    rows = read_rows(results / "rows/engines/Reach-v0.csv.xz")
    assert len(rows) == 2 * 2 * len(summary)  # engines, goals
    record = json.loads((results / "rows/engines/Reach-v0.json").read_text())
    assert "mujoco-core" in record["packages"]
    assert (results / "engines.png").stat().st_size > 1000
    assert main([*words, *runs, "--plan"]) == 0
    plan = capsys.readouterr().out
    policies = len(summary)
    assert plan.count(f"| 0 of {policies} |") == 2  # an engine each
    assert f"| all |  | 0 of {2 * policies} |" in plan
    before = {path: path.read_bytes() for path in results.rglob("*.csv*")}
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("engines/*")}
    assert main([*words, *runs]) == 2  # the table exists
    assert main([*words, *runs, "--resume"]) == 0
    assert {p: p.stat().st_mtime_ns for p in tmp_path.glob("engines/*")} == kept
    assert {path: path.read_bytes() for path in results.rglob("*.csv*")} == before
    assert main(["ablate", "engines", "--runs", str(tmp_path), "--check"]) == 0


def test_what_engines_cannot_do_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["ablate", "engines", "--runs", str(tmp_path)]
    for words, complaint in (
        (["--tasks", "Rech-v0"], "did you mean"),
        (["--goals", "0"], "goals"),
        (["--tasks"], "tasks"),
        (["--check"], "there are no rows in"),
        (["--plan", "--goals", "0"], "goals"),
        (["--engine", "ode"], "ode"),
    ):
        assert main([*asked, *words]) == 2, words
        messages = capsys.readouterr().err
        assert complaint in messages and messages.count("\n") == 1


@pytest.mark.slow
def test_studies_name_their_engine_and_do_not_mix_it(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, runs = tmp_path / "own.py", tmp_path / "runs"
    file.write_text(OWN)

    def ablate(name: str, *words: str) -> tuple[int, str]:
        small = ["--runs", str(runs), "--seeds", "0", "--workers", "1"]
        code = main(["ablate", f"{file}:{name}", *small, *words])
        text = capsys.readouterr()
        return code, text.out + text.err

    code, text = ablate("ONE", "--engine", "mujoco")
    assert code == 0 and "| own | few | mujoco 4" in text
    assert (datasets_home / "marl_mm/reach/own-mujoco-v0").exists()
    (row,) = read_rows(runs / "results/one.csv")
    assert row["engine"].startswith("mujoco 4")
    record = json.loads((runs / "results/rows/own/few.json").read_text())
    assert record["engine"] == "mujoco" and "mujoco-core" in record["packages"]
    assert ablate("ONE", "--check")[0] == 0  # of the rows' engine
    assert ablate("SLIPS", "--engine", "mujoco", "--overwrite")[0] == 0
    (probed,) = runs.rglob("eval_slips.json")
    changed = json.loads(probed.read_text())["overrides"]["simulation"]
    assert changed == {"engine": "mujoco", "wheel_friction": 0.2}
    for words in (("--engine", "bullet", "--check"), ("--engine", "bullet")):
        code, text = ablate("ONE", "--overwrite", *words)
        assert code == 2 and "is of engine mujoco, expected bullet" in text
    for plan in ([], ["--plan"]):
        code, text = ablate("SHIPPED", "--engine", "mujoco", *plan)
        assert code == 2 and "good-5k-v0 is of engine bullet, expected mujoco" in text
    code, text = ablate("BOTH")
    assert code == 0
    last, other = read_rows(runs / "results/both.csv")
    assert last["engine"].startswith("bullet") and other["engine"].startswith("mujoco")


@pytest.mark.bullet
def test_runs_and_results_of_engines_lie_apart() -> None:
    assert EnginesOptions().runs_folder == Path("runs/studies")
    assert EnginesOptions(engine="mujoco").runs_folder == Path("runs/studies-mujoco")
    with pytest.raises(UsageError, match="engine"):
        EnginesOptions(engine="ode").check_settings()  # type: ignore[arg-type]
