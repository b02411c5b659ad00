"""Committed results: what learning and the script were asked to do, they do."""

import json
import lzma
from pathlib import Path

from marl_mm.eval.rows import read_rows
from marl_mm.eval.studies.offline import BLOCKS

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
