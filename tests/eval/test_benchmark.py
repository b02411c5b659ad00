"""Tables of the benchmark, drawn from rows that are written here."""

import shutil
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from marl_mm.cli import main
from marl_mm.errors import OtherConfigError, UsageError
from marl_mm.eval.rows import read_rows, write_csv
from marl_mm.eval.studies import early
from marl_mm.eval.studies.benchmark import (
    ALGORITHM_NAMES,
    DATASETS,
    OVERALL,
    PAIRS,
    STUDY,
    TABLE,
    BenchmarkOptions,
    draw_benchmark,
)
from marl_mm.eval.studies.benchmark_tables import (
    benchmark_table,
    overall_table,
    pairs_table,
)
from marl_mm.eval.studies.early import draw_early, early_table
from marl_mm.eval.studies.study import Cell, cell_name
from marl_mm.eval.studies.tuning import DATASETS as TUNING
from marl_mm.files import write_json
from marl_mm.runs.recipes import RECIPES

RESULTS = Path(__file__).resolve().parents[2] / "eval" / "results" / "studies"

FIRST, SECOND = (RECIPES.get(name).source.name for name in DATASETS[:2])
FIRST_EARLY = RECIPES.get(early.DATASETS[0]).source.name
FEW = [cell for cell in early.STUDY.cells if cell[1].name.startswith("early-")]


def write(
    results: Path,
    dataset: str,
    algorithm: str,
    rate: float,
    seeds: int = 5,
    cells: Iterable[Cell] = STUDY.cells,
) -> None:
    """Write the rows of a cell, 40 goals a seed, with the same random numbers for all.

    So a higher rate reaches all goals of a lower one, and equal rates reach the same.
    """
    tested = {cell_name(c): c[1].algorithm for c in cells}
    (names,) = (n for n in tested if n[0] == dataset and tested[n] == algorithm)
    path = results / "rows" / names[0].replace("/", "-") / names[1]
    rng = np.random.default_rng(0)
    rows = [
        {
            "seed": seed,
            "probe": "last",
            "goal": goal,
            "direction": "backward",
            "success": int(rng.random() < rate),
        }
        for seed in range(seeds)
        for goal in range(40)
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path.with_name(f"{path.name}.json"), {"engine": "mujoco", "probes": {}})
    write_csv(path.with_name(f"{path.name}.csv.xz"), rows)


def test_tie_groups_are_within_datasets_and_the_rest_over_whole_ones(
    tmp_path: Path,
) -> None:
    for algorithm, rate in (("bc", 0.2), ("mabc", 0.9), ("td3-bc", 0.9)):
        write(tmp_path, FIRST, algorithm, rate)
    write(tmp_path, SECOND, "bc", 0.9)
    rows = draw_benchmark(tmp_path, tmp_path)
    groups = {(row["dataset"], row["algorithm"]): row["group"] for row in rows}
    assert groups == {
        (FIRST, "bc"): "2",
        (FIRST, "mabc"): "1",
        (FIRST, "td3-bc"): "1",
        (SECOND, "bc"): "1",
    }
    assert len(read_rows(tmp_path / TABLE)) == 4
    overall = {row["algorithm"]: row for row in read_rows(tmp_path / OVERALL)}
    assert [row["datasets"] for row in overall.values()] == [1, 1, 1]
    assert overall["bc"]["first"] == 0 and overall["mabc"]["first"] == 1
    assert {row["first_alone"] for row in overall.values()} == {0}
    assert overall["bc"]["iqm"] < 0.3 < 0.8 < overall["mabc"]["iqm"]
    pairs = {(r["algorithm"], r["other"]): r for r in read_rows(tmp_path / PAIRS)}
    assert pairs["bc", "mabc"]["improvement"] == 0.0
    assert pairs["mabc", "td3-bc"]["improvement"] == 0.5
    assert "| `mabc` | **1.00** |  | 0.50 |" in pairs_table(read_rows(tmp_path / PAIRS))
    assert "| 1 of 1 | 0 |" in overall_table(read_rows(tmp_path / OVERALL))
    *_, line, _, rest = benchmark_table(rows).splitlines()
    assert line.startswith("| `td3-bc` | **") and line.endswith(", 1, 5 x 40 |  |")
    assert rest.startswith("On mujoco; 5 seeds and 200 goals where")


def test_a_single_seed_is_compared_with_nothing(tmp_path: Path) -> None:
    """However good it is."""
    write(tmp_path, FIRST, "bc", 0.9, seeds=2)
    write(tmp_path, FIRST, "mabc", 1.0, seeds=1)
    rows = draw_benchmark(tmp_path, tmp_path)
    assert [row["first"] for row in rows] == [1, 0]
    *_, line, _, _ = benchmark_table(rows).splitlines()
    assert line.startswith("| `mabc` | 100.0 [") and line.endswith("], 1 x 40 |")
    overall = read_rows(tmp_path / OVERALL)
    assert [row["algorithm"] for row in overall] == ["bc"]
    assert "Over 1 of 16 datasets" in overall_table(overall)
    write(tmp_path, SECOND, "mabc", 0.5)
    draw_benchmark(tmp_path, tmp_path)
    for table, name in ((overall_table, OVERALL), (pairs_table, PAIRS)):
        assert table(read_rows(tmp_path / name)).startswith("No dataset has rows of")


def test_tables_have_whole_tasks_side_by_side(tmp_path: Path) -> None:
    for name in DATASETS:
        write(tmp_path, RECIPES.get(name).source.name, "bc", 0.5, seeds=2)
    text = benchmark_table(draw_benchmark(tmp_path, tmp_path))
    heads = [line for line in text.splitlines() if line.startswith("| algorithm")]
    tasks = [{word.split("/")[0] for word in head.split(" | ")[1:]} for head in heads]
    assert tasks == [
        {"quiet-zone"},
        {"gate", "tray"},
        {"moving-reach", "bar", "course"},
    ]
    assert sum(head.count("-v0") for head in heads) == len(DATASETS)


def test_fewer_updates_are_compared_where_there_are_runs_of_both(
    tmp_path: Path,
) -> None:
    """By the seeds that both have; equal runs gain nothing, give or take."""
    for name, few, many in (("bc", 0.2, 0.9), ("mabc", 0.5, 0.5)):
        write(tmp_path, FIRST_EARLY, name, few, seeds=3, cells=FEW)
        write(tmp_path, FIRST_EARLY, name, many)
    write(tmp_path, FIRST_EARLY, "td3-bc", 0.5, cells=FEW)
    rows = draw_early(tmp_path, tmp_path)
    assert [(row["algorithm"], row["seeds"]) for row in rows] == [
        ("bc", 3),
        ("mabc", 3),
    ]
    gained, same = rows
    assert gained["gain"] == pytest.approx(gained["success"] - gained["early"])
    assert (
        0.4 < gained["gain_interval"][0] < gained["gain"] < gained["gain_interval"][1]
    )
    low, high = same["gain_interval"]
    assert same["gain"] == 0 and low < 0 < high
    _, _, first, second, *_ = early_table(rows).splitlines()
    assert first.startswith("| `bc` | **") and "**" not in second
    record, *_ = tmp_path.rglob("*.json")
    write_json(record, {"engine": "mujoco", "probes": {}, "eval_seed": 7})
    with pytest.raises(OtherConfigError, match="made otherwise than other rows"):
        draw_early(tmp_path, tmp_path)


def test_other_algorithms_stand_last_and_change_no_row_of_the_benchmarks(
    tmp_path: Path,
) -> None:
    """Estimates over datasets are of the same draws; groups are of all pairs."""
    options = BenchmarkOptions(own=("rebrac", "cfcql"))
    ours = ("mabc", "bc")
    for name, rate in zip(ours, (0.9, 0.4), strict=True):
        write(tmp_path, FIRST, name, rate)
    draw_benchmark(tmp_path, tmp_path)
    before = read_rows(tmp_path / OVERALL), read_rows(tmp_path / PAIRS)
    for name in options.own:
        write(tmp_path, FIRST, name, 0.7, cells=options.study.cells)
    rows = draw_benchmark(tmp_path, tmp_path)
    assert [row["algorithm"] for row in rows] == ["bc", "mabc", "cfcql", "rebrac"]
    assert [row["group"] for row in rows] == ["3", "1", "2", "2"]
    overall, pairs = read_rows(tmp_path / OVERALL), read_rows(tmp_path / PAIRS)
    assert (overall[:2], pairs[:1]) == before and len(pairs) == 6
    assert benchmark_table(rows).splitlines()[-3].startswith("| `rebrac` |")


def test_what_others_have_learnt_from_is_no_matter_of_an_own_algorithm(
    tmp_path: Path,
) -> None:
    """It stands beside them over the datasets that it has."""
    options = BenchmarkOptions(own=("cfcql",))
    for dataset, rate in ((FIRST, 0.9), (SECOND, 0.3)):
        for name in ("bc", "mabc"):
            write(tmp_path, dataset, name, rate)
    draw_benchmark(tmp_path, tmp_path)
    before = read_rows(tmp_path / OVERALL), read_rows(tmp_path / PAIRS)
    write(tmp_path, SECOND, "cfcql", 0.6, cells=options.study.cells)
    draw_benchmark(tmp_path, tmp_path)
    *overall, own = read_rows(tmp_path / OVERALL)
    pairs = {(r["algorithm"], r["other"]): r for r in read_rows(tmp_path / PAIRS)}
    for row, earlier in zip(overall, before[0], strict=True):
        assert {**row, "first": 0} == {**earlier, "first": 0}  # another may be best
    assert [pairs["bc", "mabc"]] == before[1]
    assert own["datasets"] == 1 and own["first_alone"] == 1
    assert pairs["bc", "cfcql"]["improvement"] == 0.0
    text = overall_table([*overall, own])
    assert "Over 2 of 16 datasets: those that all of the benchmark have" in text


@pytest.mark.parametrize(
    "change",
    [
        {"dataset": {"fingerprint": "b"}},
        {"eval_episodes": 2},
        {"eval_seed": 7},
        {"updates": 5},
    ],
)
def test_rows_of_other_goals_or_data_are_in_no_table_with_these(
    change: dict[str, Any], tmp_path: Path
) -> None:
    for name in ("bc", "mabc"):
        write(tmp_path, FIRST, name, 0.5)
    (record,) = tmp_path.rglob("*-mabc.json")
    write_json(record, {"engine": "mujoco", "probes": {}, **change})
    (key,) = change
    named = "fingerprint" if key == "dataset" else key
    with pytest.raises(OtherConfigError, match=f"-mabc.json was made .*: {named} = "):
        draw_benchmark(tmp_path, tmp_path)


def test_an_own_algorithm_is_an_offline_one() -> None:
    no_data = "expected an algorithm that learns from"
    for name, complaint in (
        ("ddpg", f"learns online, {no_data}"),
        ("rlpd", f"learns online, beside a dataset, {no_data}"),
        ("bcc", "did you mean"),
    ):
        with pytest.raises(UsageError, match=complaint):
            _ = BenchmarkOptions(own=(name,)).study
    cells = BenchmarkOptions(own=("mabc",)).study.cells
    assert cells == STUDY.cells  # which has it


def test_without_rows_there_is_no_table(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="run marl-mm ablate benchmark"):
        draw_benchmark(tmp_path, tmp_path)
    with pytest.raises(UsageError, match="run marl-mm ablate early"):
        draw_early(tmp_path, tmp_path)


def test_no_dataset_is_one_of_the_tuning_and_every_axis_and_task_is_there() -> None:
    recipes = [RECIPES.get(name) for name in DATASETS]
    assert not {*DATASETS} & {*TUNING} and len({*DATASETS}) == 16
    assert {*early.DATASETS} <= {*DATASETS}
    assert {recipe.axis for recipe in recipes} >= {
        *("expert", "noisy", "explore", "stitch", "conventions", "one-bad"),
        *("narrow", "rare"),
    }
    assert len({recipe.source.task.split("-")[0] for recipe in recipes}) == 6


@pytest.mark.slow
def test_it_runs_where_policies_are_tested_elsewhere_and_goes_on_from_its_rows(
    datasets_home: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Gate-stitch has data of a task of halves, and its policies act in the whole."""
    folders = ["--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]
    words = ["ablate", "benchmark", *folders, "--seeds", "0", "--workers", "1"]
    words += ["--datasets", "gate-expert", "marl_mm/gate/stitch-v0"]  # a name or an id
    words += ["--settings", "benchmark-mabc", "gate-v0-mabc", "--budget", "smoke"]
    assert main(words) == 0
    assert "| `mabc` |" in capsys.readouterr().out
    (expert, stitch) = read_rows(tmp_path / "out" / TABLE)
    assert (expert["task"], stitch["task"]) == ("Gate-v0", "Gate-v0")
    shutil.rmtree(tmp_path / "runs")
    assert main([*words, "--resume"]) == 0  # of the rows that are there
    assert not list((tmp_path / "runs").glob("marl_mm-gate-*"))
    assert main(["ablate", "benchmark", "--check", *folders]) == 0


def test_what_is_committed_is_of_the_settings_that_are_compared(
    datasets_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing of a whole dataset is missing, and no record names another setting."""
    rows = [row for row in read_rows(RESULTS / TABLE) if row["seeds"] == STUDY.seeds]
    algorithms = Counter(row["dataset"] for row in rows)
    whole = [name for name, n in algorithms.items() if n == len(ALGORITHM_NAMES)]
    words = ["ablate", "benchmark", "--plan", "--datasets", *whole]
    assert main([*words, "--out", str(RESULTS), "--runs", str(tmp_path)]) == 0
    assert "| all |  | 0 of 0 |" in capsys.readouterr().out


def test_a_loss_by_more_updates_shows_as_a_gain_does(tmp_path: Path) -> None:
    """Of a single seed neither is."""
    for name, seeds in (("bc", 3), ("mabc", 1)):
        write(tmp_path, FIRST_EARLY, name, 0.9, seeds, cells=FEW)
        write(tmp_path, FIRST_EARLY, name, 0.2, seeds)
    rows = draw_early(tmp_path, tmp_path)
    assert all(row["gain_interval"][1] < 0 for row in rows)
    _, _, first, second, *_ = early_table(rows).splitlines()
    assert first.startswith("| `bc` | **") and "**" not in second
