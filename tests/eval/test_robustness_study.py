"""Teams against joint actors: what is compared, and by which numbers."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from marl_mm.algorithms.chosen import CHOSEN
from marl_mm.algorithms.registry import ALGORITHMS, preset
from marl_mm.cli import main
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import read_rows, write_csv
from marl_mm.eval.studies import robustness
from marl_mm.eval.studies.robustness import (
    STUDY,
    RobustCell,
    RobustnessOptions,
    cells_of,
)
from marl_mm.eval.studies.robustness_summary import (
    FORMS,
    SOURCES,
    cross_play_table,
    draw_robustness,
    robustness_table,
)
from marl_mm.eval.studies.study import cell_name
from marl_mm.eval.studies.targets import COMPARISONS, STUDIES


def test_both_forms_learn_with_the_same_settings() -> None:
    for joint, team in FORMS:
        settings = [preset(name) for name in (joint, team)]
        assert not any(ALGORITHMS.get(name).online for name in (joint, team))
        for name in ("learning_rate", "hidden", "batch_size"):
            values = [getattr(config, name, None) for config in settings]
            assert values[0] == values[1], (joint, team, name)
    tuned = [form for form in FORMS if {*form} <= CHOSEN.keys()]
    assert len(STUDY.cells) == 2 * len(tuned) * len(SOURCES)


def test_no_other_study_has_its_runs() -> None:
    others = {setting.name for study in STUDIES.values() for _, setting in study.cells}
    assert not others & {setting.name for _, setting in STUDY.cells}


def rows(setting: str, reached: Any) -> Any:
    """Rows of two seeds and two goals each, by disturbance, agent and strength."""
    head = {"dataset": next(iter(SOURCES)), "setting": setting, "engine": "mujoco 4"}
    return [
        head
        | {"disturbance": name, "agent": agent, "strength": strength}
        | {"seed": seed, "goal": goal, "success": successes[2 * seed + goal]}
        for (name, agent, strength), successes in reached.items()
        for seed, goal in product(range(2), range(2))
    ]


def drawn(results: Path, joint: Any, team: Any) -> list[Row]:
    """Table of a joint form and a team, of ``rows``."""
    for setting, reached in (("robust-bc", joint), ("robust-mabc", team)):
        path = results / f"rows/robustness/{setting}.csv.xz"
        write_csv(path, rows(setting, reached))
    return draw_robustness(results, results)


def test_what_a_team_keeps_more_by_hand(tmp_path: Path) -> None:
    """The mean over agents and strengths first, then over disturbances."""
    joint = {
        ("clean", "", 0): (1, 1, 1, 1),
        ("late", "hand", 1): (0, 0, 1, 1),
        ("late", "balance", 1): (0, 0, 0, 0),
        ("engine", "", 0): (1, 1, 1, 0),
    }
    team = {
        ("clean", "", 0): (1, 1, 0, 0),
        ("late", "hand", 1): (1, 1, 0, 0),
        ("late", "balance", 1): (1, 0, 0, 0),
        ("engine", "", 0): (1, 1, 0, 0),
    }
    late, engine, every = drawn(tmp_path, joint, team)
    assert (late["joint_clean"], late["team_clean"]) == (1.0, 0.5)
    assert (late["joint_change"], late["team_change"]) == (-0.75, -0.125)
    assert late["keeps_more"] == 0.625 and engine["keeps_more"] == 0.25
    assert every["disturbance"] == "all" and every["keeps_more"] == 0.4375
    low, high = late["keeps_more_interval"]
    assert low < 0.625 < high
    assert (late["ahead"], engine["ahead"], every["ahead"]) == (0.125, -0.25, -0.0625)
    few = {"joint_clean": 0.2}
    assert "(-6.2 [" in robustness_table([late, engine, every | few])
    table = robustness_table([late, engine, every])
    assert "| `gate-expert` | `bc`, `mabc` | 100.0, -50.0 | 50.0, -6.2 |" in table
    assert (tmp_path / "robustness.csv").exists()


def test_what_agents_of_other_runs_reach_by_hand(tmp_path: Path) -> None:
    """The mean over the other seeds; and the change of each other algorithm."""
    joint = {
        ("clean", "", 0): (1, 1, 1, 1),
        ("other seed", "hand", 1): (1, 1, 1, 1),
        ("late", "hand", 1): (1, 1, 1, 1),
    }
    team = {
        ("clean", "", 0): (1, 1, 0, 0),
        ("late", "hand", 1): (0, 0, 0, 0),
        ("other seed", "hand", 1): (1, 0, 0, 0),
        ("other seed", "hand", 2): (0, 0, 0, 1),
        ("other algorithm", "hand", "ma-iql"): (1, 1, 1, 1),
        ("other algorithm", "balance", "ma-iql"): (0, 0, 0, 0),
    }
    both = drawn(tmp_path, joint, team)  # of the disturbances that both met
    changes = [(row["disturbance"], row["team_change"]) for row in both]
    assert changes == [("other seed", -0.25), ("late", -0.5), ("all", -0.5)]
    crossed = read_rows(tmp_path / "robustness_cross_play.csv")
    found = {(r["agent"], r["from"]): (r["success"], r["difference"]) for r in crossed}
    assert found.pop(("hand", "bc")) == (1.0, 0.0)
    assert found == {
        ("hand", "mabc"): (0.25, -0.25),
        ("hand", "ma-iql"): (1.0, 0.5),
        ("balance", "ma-iql"): (0.0, -0.5),
    }
    assert "| `mabc` | 25.0, -25.0 | 100.0, +50.0 |" in cross_play_table(crossed)
    sure = [row | {"difference_interval": (0.1, 0.9)} for row in crossed]
    assert "100.0, **+50.0**" in cross_play_table(sure)


@pytest.mark.slow
def test_it_is_trained_disturbed_once_and_checked(
    datasets_home: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    part = STUDY.part([next(iter(SOURCES))], ["robust-bc", "robust-mabc"])
    monkeypatch.setattr(robustness, "STUDY", part)
    comparison = replace(COMPARISONS["robustness"], study=part)
    monkeypatch.setitem(COMPARISONS, "robustness", comparison)
    ran: list[str] = []

    def run(options: Any, cell: RobustCell) -> list[Row]:
        ran.append(cell.label)
        return run_cell(options, cell)

    run_cell = robustness.run_cell
    monkeypatch.setattr(robustness, "run_cell", run)
    runs = ["--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]
    words = ["ablate", "robustness", *runs, "--seeds", "0", "1", "--workers", "1"]
    words += ["--budget", "smoke", "--datasets", "gate-expert"]
    assert main(words) == 0
    assert "`bc`, `mabc`" in capsys.readouterr().out and len(ran) == 4
    assert main([*words, "--resume"]) == 0
    assert len(ran) == 4
    assert main(["ablate", "robustness", "--check", *runs]) == 0
    crossed = read_rows(tmp_path / "out/robustness_cross_play.csv")
    assert {(row["algorithm"], row["from"]) for row in crossed} == {
        ("bc", "bc"),
        ("mabc", "mabc"),
    }
    (tmp_path / "runs/marl_mm-gate-expert-v0/robust-bc").rename(tmp_path / "bc")
    assert main([*words, "--resume"]) == 0  # its rows are there
    (made,) = (tmp_path / "out/rows/robustness").glob("*-robust-bc.json")
    made.unlink()
    assert main([*words, "--resume"]) == 2
    assert "robust-bc/0 is gone" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "goals"), [("gate-expert", 50), ("bar-expert", 13)])
def test_a_part_has_its_datasets_runs_and_fewer_goals_of_long_tasks(
    name: str, goals: int
) -> None:
    options = RobustnessOptions(datasets=(name,))
    cells = [cell_name(cell) for cell in options.study.cells]
    assert len(cells) == len(STUDY.cells) / 2
    made = [cell for names in cells for cell in cells_of(options, *names)]
    assert {(SOURCES[cell.dataset], cell.goals) for cell in made} == {(name, goals)}
