"""The alpha sweep: cells, summaries, what a rule is worth; and what alpha does."""

import importlib
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from marl_mm.cli import main
from marl_mm.collectors.pd import PdConfig
from marl_mm.control.config import Form
from marl_mm.control.priorities import stability_share
from marl_mm.eval.metrics import Row
from marl_mm.eval.studies import sweep
from marl_mm.eval.studies.sweep_cells import SweepCell, load_cells, run_cell
from marl_mm.eval.studies.sweep_summary import (
    summarize_cells,
    summarize_loads,
    worth_of_a_rule,
)
from marl_mm.sim.config import Engine

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools"))
TABLES: Any = importlib.import_module("sweep_tables")

SMALL = SweepCell("Reach-v0", "blend", PdConfig(alpha=0.5), 2, 0, 12)
ARGUMENTS = (
    *("--alphas", "3", "--goals", "2", "--worth-goals", "2", "--load-goals", "0"),
    *("--workers", "1", "--engine", "mujoco"),
    *("--forms", "blend", "--tasks", "Reach-v0", "SmoothReach-v0"),
)


def row(alpha: float, direction: str, goal: int = 0, **values: float) -> Row:
    return {
        "task": "Reach-v0",
        "form": "blend",
        "rule": "constant",
        "alpha": alpha,
        "seed": 0,
        "goal": goal,
        "direction": direction,
        "success": 1,
        "steps": 10,
        "return": 1.0,
        "d_mm": 0.0,
        "d_mp": 0.0,
        "base_jerk_rms": 1.0,
        "zmp_margin": 0.2,
        "qp_failures": 0,
        **values,
    }


def test_both_tasks_returns_come_from_one_run() -> None:
    rows = run_cell(SMALL)
    assert [one["task"] for one in rows] == ["Reach-v0", "SmoothReach-v0"] * 2
    for reach, smooth in zip(rows[::2], rows[1::2], strict=True):
        cost = 0.2 * reach["base_jerk_rms"] * reach["steps"]
        assert smooth["return"] == pytest.approx(reach["return"] - cost)
    assert run_cell(SMALL) == rows


def test_rows_and_tables_name_the_engine_where_rows_do() -> None:
    rows = run_cell(replace(SMALL, engine="mujoco"))
    assert {one["engine"] for one in rows} == {"mujoco 4.0.0"}
    assert {one["engine"] for one in summarize_cells(rows)} == {"mujoco 4.0.0"}
    assert "engine" not in summarize_cells([row(0.5, "backward")])[0]


def test_summary_by_hand() -> None:
    rows = [
        row(0.5, "backward", steps=25, d_mm=0.01, zmp_margin=0.1, qp_failures=2),
        row(0.5, "backward", steps=26, d_mm=0.03, qp_failures=3),
        row(0.5, "backward", steps=50, d_mm=0.02, success=0),
    ]
    (summary,) = summarize_cells(rows)
    assert summary["goals"] == 3
    assert summary["steps"] == pytest.approx(101 / 3)
    assert summary["success_25"] == pytest.approx(1 / 3)
    assert summary["success_50"] == pytest.approx(2 / 3)
    assert summary["d_mm"] == pytest.approx(0.02)
    assert (summary["zmp_margin"], summary["qp_failures"]) == (0.1, 5)


def test_response_by_hand() -> None:
    """Steps 10, 12, 20: the second half makes 80 %; d_mm falls once by 1 mm."""
    rows = [
        row(0.0, "backward", steps=10, d_mm=0.001, d_mp=0.05),
        row(0.5, "backward", steps=12, d_mm=0.011, d_mp=0.03),
        row(1.0, "backward", steps=20, d_mm=0.010, d_mp=0.04),
        row(0.0, "forward", d_mm=0.002),
        row(0.5, "forward", d_mm=0.009),
        row(1.0, "forward", d_mm=0.003),
    ]
    (response,) = TABLES.responses(summarize_cells(rows))
    assert response["largest_share"] == pytest.approx(0.8)
    assert response["at"] == 0.5
    assert response["d_mm_falls"] == pytest.approx(0.001)
    assert response["d_mp_rises"] == pytest.approx(0.01)
    assert response["hump"] == pytest.approx(0.006)


@pytest.mark.slow
def test_loads_are_carried_by_all_alphas_to_the_same_goals() -> None:
    cells = load_cells(2, 0)
    assert len({(cell.mass, cell.pd.alpha) for cell in cells}) == len(cells)
    light, heavy = cells[0], cells[-1]
    rows = [*run_cell(light), *run_cell(replace(heavy, pd=light.pd))]
    assert [one["mass"] for one in rows] == [light.mass] * 2 + [heavy.mass] * 2
    assert all(one["success"] for one in rows)
    for name in ("zmp_margin", "zmp_fore_aft"):  # what a mass takes off it
        margins = [one[name] for one in rows]
        assert max(margins[2:]) < max(margins[:2])
    assert all(one["zmp_margin"] <= one["zmp_fore_aft"] for one in rows)


def test_what_alpha_gains_is_paired_by_goal() -> None:
    rows = [
        row(
            alpha,
            "forward",
            goal,
            mass=mass,
            zmp_margin=0.1 * goal + 0.02 * mass * alpha,
            zmp_fore_aft=0.1,
            zmp_span=0.1 - 0.05 * alpha,
        )
        for mass in (1.0, 3.0)
        for alpha in (0.0, 1.0)
        for goal in range(4)
    ]
    first, light, _, heavy = summarize_loads(rows)
    assert (first["zmp_margin_gain"], first["goals"]) == (0.0, 4)
    assert light["zmp_margin_gain"] == pytest.approx(0.02)
    assert light["zmp_margin_gain_interval"] == pytest.approx((0.02, 0.02))
    assert light["zmp_margin_least"] == pytest.approx(0.02)
    assert heavy["zmp_margin_more_interval"] == pytest.approx((0.04, 0.04))
    table = TABLES.load_table(summarize_loads(rows))
    assert "| 150, 170 | 20.0 [20.0, 20.0] | 0.0 [0.0, 0.0] |" in table
    assert "| 150, 210 | 60.0 [60.0, 60.0] | 40.0 [40.0, 40.0] |" in table
    assert "| 100, 50 |" in table


def test_worth_is_paired_by_goal() -> None:
    rows = []
    for goal in range(20):
        rows.append(row(0.2, "forward", goal, **{"return": float(goal)}))
        rule = row(0.2, "forward", goal, **{"return": goal + 1.0 + goal % 2})
        rows.append({**rule, "rule": "room"})
    (worth,) = worth_of_a_rule(rows, "Reach-v0")
    assert worth["difference"] == pytest.approx(1.5)
    assert 1.2 < worth["interval"][0] < 1.5 < worth["interval"][1] < 1.8
    assert worth["better_on"] == 20


def test_stability_share_reaches_its_ends() -> None:
    assert [stability_share(alpha, 2.0) for alpha in (0.0, 0.5, 1.0)] == [0, 0.75, 1]
    assert stability_share(0.3, 1.0) == pytest.approx(0.3)


@pytest.mark.slow
def test_the_command_resumes_to_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Interrupted after two settings, it keeps them, and ends in the same files."""
    monkeypatch.setattr(sweep, "FINE", 0.5)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    assert main(["sweep-alpha", "--out", str(whole), *ARGUMENTS, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {one["alpha"] for one in printed["alpha"]} == {0.0, 0.5, 1.0}

    done: list[SweepCell] = []

    def interrupted(cell: SweepCell) -> list[Row]:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(cell)
        return run_cell(cell)

    with monkeypatch.context() as patch:
        patch.setattr(sweep, "run_cell", interrupted)
        assert main(["sweep-alpha", "--out", str(cut), *ARGUMENTS]) == 130
    assert not cut.exists()
    assert "--resume" in capsys.readouterr().err
    assert main(["sweep-alpha", "--out", str(cut), *ARGUMENTS]) == 2
    assert "was begun already: go on with --resume" in capsys.readouterr().err
    ran: list[SweepCell] = []

    def counted(cell: SweepCell) -> list[Row]:
        ran.append(cell)
        return run_cell(cell)

    with monkeypatch.context() as patch:
        patch.setattr(sweep, "run_cell", counted)
        resume = ["sweep-alpha", "--out", str(cut), *ARGUMENTS, "--resume"]
        assert main(resume) == 0
    assert not set(ran) & set(done)
    for name in ("episodes.csv.xz", "alpha.csv", "worth.csv"):
        assert (cut / name).read_bytes() == (whole / name).read_bytes(), name
    for name in ("response.png", "pareto.png", "config.json"):
        assert (cut / name).stat().st_size > 100
    before = {path: path.stat().st_mtime_ns for path in cut.iterdir()}
    assert main(resume) == 0  # nothing is left to do
    assert {path: path.stat().st_mtime_ns for path in cut.iterdir()} == before
    assert main([*resume, "--seed", "9"]) == 2  # another sweep is there
    again = ["sweep-alpha", "--out", str(cut), *ARGUMENTS, "--seed", "9"]
    with monkeypatch.context() as patch:
        patch.setattr(sweep, "run_cell", interrupted)  # at once
        assert main([*again, "--overwrite"]) == 130
    assert {path: path.stat().st_mtime_ns for path in cut.iterdir()} == before
    assert main([*again, "--resume"]) == 0
    assert json.loads((cut / "config.json").read_text())["options"]["seed"] == 9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "engine"),
    [
        pytest.param("blend", "bullet", marks=pytest.mark.bullet),
        ("rhp", "mujoco"),
    ],
)
def test_alpha_trades_the_hand_for_the_base(form: Form, engine: Engine) -> None:
    """Backward, d_mm and steps grow, d_mp and jerk shrink from alpha to alpha."""
    cell = SweepCell("Reach-v0", form, PdConfig(), 4, 3, engine=engine)
    rows: list[Row] = []
    for alpha in (0.0, 0.4, 0.7, 1.0):
        rows += run_cell(replace(cell, pd=PdConfig(alpha=alpha)))
    back = [
        one
        for one in summarize_cells(rows)
        if (one["direction"], one["task"]) == ("backward", "Reach-v0")
    ]
    assert (np.diff([one["d_mm"] for one in back]) > 0).all()
    assert (np.diff([one["d_mp"] for one in back]) < 0).all()
    assert (np.diff([one["steps"] for one in back]) > 0).all()
    assert (np.diff([one["base_jerk_rms"] for one in back]) < 0).all()
    assert sum(one["qp_failures"] for one in back) == 0


def test_only_a_sweep_is_replaced_by_a_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of version 1, too; a folder that holds anything else stays as it is."""

    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sweep, "run_cells", interrupted)  # all has been checked then
    words = ["sweep-alpha", "--out", str(tmp_path), *ARGUMENTS, "--overwrite"]
    (tmp_path / "config.json").write_text('{"options": {}}')
    for name in ("alpha.md", "pareto.svg", "drawn_with.txt", "episodes.csv.gz"):
        (tmp_path / name).touch()
    assert main(words) == 130
    (tmp_path / "thesis.tex").touch()
    assert main(words) == 2
    assert "thesis.tex, which is not of marl-mm" in capsys.readouterr().err
