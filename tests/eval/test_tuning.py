"""Tuning: what is tried of each algorithm, and what is chosen."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from marl_mm.algorithms.chosen import CHOSEN
from marl_mm.algorithms.registry import ALGORITHMS, BENCHMARK, preset
from marl_mm.cli import main
from marl_mm.config_diff import as_json
from marl_mm.errors import DivergedError, UsageError
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import read_rows, write_csv
from marl_mm.eval.studies import tuning, tuning_cells
from marl_mm.eval.studies.benchmark import STUDY
from marl_mm.eval.studies.tuning import (
    DATASETS,
    TABLE,
    TuningOptions,
    cells_of,
    draw_tuning,
)
from marl_mm.eval.studies.tuning_cells import (
    TuningCell,
    cell_of,
    run_cell,
    settings_of,
)
from marl_mm.eval.studies.tuning_ranges import RANGES
from marl_mm.files import write_json
from marl_mm.runs import train
from marl_mm.runs.settings import with_settings

RESULTS = Path(__file__).resolve().parents[2] / "eval/results/studies"

GOES_ON_ONLINE = {"rlpd", "ma-rlpd", "cal-ql", "ma-cal-ql"}
"""Algorithms that are made for own episodes after the data."""


def test_every_offline_algorithm_is_tuned_with_as_many_settings() -> None:
    offline = {n for n, algorithm in ALGORITHMS.items() if not algorithm.online}
    assert RANGES.keys() == offline - GOES_ON_ONLINE
    cells = cells_of(TuningOptions())
    assert {len(listed) for listed in cells.values()} == {12 * 2}
    assert {cell.seeds for listed in cells.values() for cell in listed} == {(0, 1)}


@pytest.mark.parametrize("name", RANGES)
def test_settings_are_the_preset_and_others_none_twice(name: str) -> None:
    tried = settings_of(name, 12)
    assert tried[0] == {} and settings_of(name, 12) == tried
    assert len({json.dumps(some) for some in tried}) == 12
    preset = ALGORITHMS.get(name).presets["tuned"]
    for some in tried[1:]:
        assert any(getattr(preset, key) != value for key, value in some.items())
        assert some.keys() == RANGES[name].keys()


def test_joint_and_team_forms_are_tried_with_the_same_settings() -> None:
    for team, joint in (("mabc", "bc"), ("ma-iql", "iql"), ("matd3-bc", "td3-bc")):
        assert settings_of(team, 12) == settings_of(joint, 12)


def test_more_settings_than_there_are_and_unknown_names_are_refused() -> None:
    with pytest.raises(UsageError, match="`tried` is 1000, expected at most 24"):
        settings_of("bc", 1000)
    with pytest.raises(UsageError, match="`algorithms` has 'ddpg'"):
        TuningOptions(algorithms=("ddpg",)).check_settings()
    with pytest.raises(UsageError, match="tray-noisy"):
        TuningOptions(data=("tray-nosy",)).check_settings()


def test_the_best_mean_over_datasets_and_seeds_is_chosen(tmp_path: Path) -> None:
    """Of equals the one with the larger return."""
    success = {
        0: (1.0, 0.0, 0.2, 0.2),
        1: (0.6, 0.6, 0.6, 0.5),
        2: (0.6, 0.6, 0.6, 0.5),
    }
    rows = [
        {
            **{"algorithm": "bc", "setting": number, "dataset": DATASETS[place % 2]},
            **{"seed": place // 2, "success": rate, "return": float(number)},
            "changes": json.dumps({"learning_rate": number}),
        }
        for number, rates in success.items()
        for place, rate in enumerate(rates)
    ]
    (tmp_path / "rows/tuning").mkdir(parents=True)
    write_csv(tmp_path / "rows/tuning/bc.csv.xz", rows)
    packages = {"packages": {"mujoco-core": "4.2"}}
    write_json(tmp_path / "rows/tuning/bc.json", packages)
    summary = draw_tuning(tmp_path, tmp_path)
    assert [row["chosen"] for row in summary] == [0, 0, 1]
    assert summary[0]["success"] == pytest.approx(0.35)
    assert summary[0]["success_each"] == "0.600 0.100" and summary[0]["seeds"] == 2
    assert summary[0]["engine"] == "mujoco 4.2"
    assert "learning_rate` 2" in tuning.tuning_table(summary)


def test_what_is_chosen_is_what_the_committed_table_says() -> None:
    table = RESULTS / TABLE
    chosen = {
        row["algorithm"]: json.loads(row["changes"])
        for row in (read_rows(table) if table.exists() else [])
        if row["chosen"]
    }
    assert as_json(dict(CHOSEN)) == chosen
    for name, changes in CHOSEN.items():
        made = with_settings(name, preset(name), {**changes, "updates": 20_000})
        assert preset(name, BENCHMARK) == made
    for _, setting in STUDY.cells:
        assert setting.config == preset(setting.algorithm, BENCHMARK)


def test_rows_are_of_the_presets_values_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A preset that changes makes another run of the setting that names no change."""
    options = TuningOptions(algorithms=("bc",))
    (before, *_) = cells_of(options)["bc"]
    changed = replace(preset("bc"), learning_rate=0.5)
    monkeypatch.setattr(tuning_cells, "preset", lambda name: changed)
    (after, *_) = cells_of(options)["bc"]
    assert before.changes == after.changes == () and before != after


@pytest.mark.slow
def test_an_algorithm_that_is_tuned_already_is_not_run_again(
    datasets_home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even in another folder of runs; what is asked for beside it is."""
    out = ["--out", str(tmp_path / "out"), "--budget", "smoke", "--seeds", "0"]
    words = ["ablate", "tuning", *out, "--workers", "1"]
    assert main([*words, "--runs", str(tmp_path / "a"), "--algorithms", "bc"]) == 0
    ran: list[str] = []

    def run(cell: TuningCell) -> list[Row]:
        ran.append(cell.algorithm)
        return run_cell(cell)

    monkeypatch.setattr(tuning, "run_cell", run)
    monkeypatch.setattr(tuning, "named_card", lambda name: {"ships": False})
    monkeypatch.setattr(tuning, "build_dataset", lambda name, **_: built.append(name))
    built: list[str] = []
    assert (
        main([*words, "--runs", str(tmp_path / "b"), "--algorithms", "bc", "--resume"])
        == 0
    )
    assert ran == built == []  # nothing is missing
    more = ["--runs", str(tmp_path / "b"), "--algorithms", "bc", "mabc", "--resume"]
    assert main([*words, *more]) == 0
    assert set(ran) == {"mabc"} and built == ["gate-expert"]
    assert main(["ablate", "tuning", "--check", "--out", str(tmp_path / "out")]) == 0


@pytest.mark.slow
def test_a_run_that_diverges_counts_as_one_that_reaches_nothing(
    datasets_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And leaves the others of its setting as they are."""

    def trained(*arguments: Any) -> Any:
        if 1 in arguments[3]:
            raise DivergedError("the critic is nan")
        return train.trained(*arguments)

    monkeypatch.setattr(tuning_cells, "trained", trained)
    cell = cell_of("bc", 0, {}, "gate-expert", (0, 1), updates=20, goals=2)
    first, second = run_cell(cell)
    assert first.keys() == second.keys()
    assert np.isfinite(first["cloning"]) and np.isnan(second["cloning"])
    assert second["success"] == 0.0 and second["return"] == -np.inf
