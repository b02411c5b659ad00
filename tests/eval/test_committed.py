"""Committed results: what learning and the script were asked to do, they do."""

import json
import lzma
from operator import itemgetter
from pathlib import Path

from marl_mm.eval.grouping import grouped
from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies.coordination import TABLE, WORTH
from marl_mm.eval.studies.offline import BLOCKS
from marl_mm.runs.recipes import RECIPES, recorded

RESULTS = Path(__file__).resolve().parents[2] / "eval/results"


def test_the_script_does_what_others_are_to_learn_from_it() -> None:
    """On every task with a block, and on as many goals as these are evaluated on."""
    for task in (source.task for source in BLOCKS):
        packed = (RESULTS / f"script/{task}.json.xz").read_bytes()
        (found,) = json.loads(lzma.decompress(packed))
        assert found["task"] == task and found["overrides"] == {}
        assert len({row["index"] for row in found["episodes"]}) == 200
        assert sum(row["success"] for row in found["episodes"]) >= 190


def test_imitation_of_the_script_does_what_was_asked_of_it() -> None:
    """From 20,000 steps, with three seeds; tests hold the table to its rows."""
    asked = {"CarryReach-v0": 0.9, "GraspReach-v0": 0.8}
    summary = read_rows(RESULTS / "studies/blocks.csv")
    for source in BLOCKS:
        (row,) = (
            row
            for row in summary
            if (row["dataset"], row["setting"]) == (source.name, "mabc")
        )
        assert (row["seeds"], row["goals"]) == (3, 200)
        assert row["success"] >= asked.get(source.task, 0.9)


def test_imitated_demonstrations_teach_a_grasp_online() -> None:
    """Within 5,000 episodes, by the best policy of each of three seeds."""
    (row,) = read_rows(RESULTS / "studies/grasp.csv")
    assert row["seeds"] == 3
    assert row["success_best"] >= 0.95 and row["episodes"] <= 5_000


# --- Named datasets, and what comes apart on them ------------------------------


def test_every_recipe_is_on_record_and_holds_what_it_is_to_hold() -> None:
    """Of "rare" and "explore" few episodes reach the goal, of scripts alone all."""
    rows, only = recorded(), (1.0, 1.0)
    asked = {"rare": (0.02, 0.05), "explore": (0.05, 0.1), "conventions": only}
    asked |= dict.fromkeys(("expert", "stitch", "narrow"), only)
    assert list(rows) == list(RECIPES.names())
    for name, recipe in RECIPES.items():
        row = rows[name]
        assert row["recipe"] == recipe.fingerprint, name
        reached = row["success"] * row["episodes"]
        assert row["success"] == round(reached) / row["episodes"], name
        low, high = asked.get(recipe.axis, (0.0, 1.0))
        assert low <= row["success"] <= high, name
    hashes = {row["data_sha256"] for row in rows.values()}
    assert len(hashes) == len(rows) and {len(text) for text in hashes} == {64}


def test_datasets_set_algorithms_apart() -> None:
    """On six at least, by 30 points, with intervals that do not touch."""
    rows = read_rows(RESULTS / "studies/separation.csv")
    assert {(row["seeds"], row["goals"]) for row in rows} == {(5, 200)}
    settings = "mabc-5k", "td3-bc-5k", "matd3-bc-5k", "iql-5k"
    apart, near_all = 0, dict.fromkeys(settings, 0)
    for of_dataset in grouped(rows, "dataset").values():
        assert tuple(row["setting"] for row in of_dataset) == settings
        worst, *_, best = sorted(of_dataset, key=itemgetter("success"))
        gap = best["success_interval"][0] - worst["success_interval"][1]
        apart += best["success"] - worst["success"] >= 0.3 and gap > 0
        for row in of_dataset:
            near_all[row["setting"]] += row["success"] > 0.98
    assert apart >= 6 and max(near_all.values()) <= 2
    (cloned,) = (
        row["success"]
        for row in rows
        if (row["dataset"], row["setting"]) == ("marl_mm/bar/conventions-v0", "mabc-5k")
    )
    assert cloned <= 0.5


def test_the_team_decides_what_its_tasks_are_about() -> None:
    """An alpha that follows the state, a partner that acts, the same convention."""
    worth = {row["task"]: row for row in read_rows(RESULTS / f"studies/{WORTH}")}
    for task in ("QuietZone-v0", "Gate-v0", "Tray-v0", "Course-v0"):
        assert worth[task]["difference"] >= 0.3, task
        assert worth[task]["expert"] - worth[task]["constant"] >= 0.3, task
    assert len(worth) == 6
    assert all(row["random_partner"] <= 0.3 for row in worth.values())
    teams = read_rows(RESULTS / f"studies/{TABLE}")
    partners = [row for row in teams if str(row["team"]).startswith("random ")]
    assert len(partners) == 14 and all(row["success"] <= 0.3 for row in partners)
    bar = {row["team"]: row["success"] for row in teams if row["task"] == "Bar-v0"}
    for one, other in (("over", "under"), ("under", "over")):
        assert bar[f"{one} and {one}"] >= 0.95 and bar[f"{one} and {other}"] < 0.4
