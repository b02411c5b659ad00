"""Which checkpoint is the best, and what is read of a record that was cut off."""

import json
from pathlib import Path

import pytest

from marl_mm.algorithms.runlog import METRICS, RunLog, is_best, read_metrics
from marl_mm.errors import CheckpointError


def row(success: float, gained: float, step: int = 1) -> dict[str, float]:
    return {"step": step, "success/all": success, "return/all": gained}


@pytest.mark.parametrize(
    ("new", "best"),
    [
        (row(0.6, -9.0), True),  # success comes first,
        (row(0.4, -1.0), False),
        (row(0.5, -2.0), True),  # then the return,
        (row(0.5, -4.0), False),
        (row(0.5, -3.0), False),  # and of equals the first stays
        ({"step": 1}, False),
    ],
)
def test_the_best_has_the_most_success_and_of_equals_the_highest_return(
    new: dict[str, float], best: bool
) -> None:
    assert is_best(new, [row(0.2, -1.0), row(0.5, -3.0), {"step": 1}]) == best


def test_the_first_that_was_measured_is_the_best_so_far() -> None:
    assert is_best(row(0.0, -30.0), [])
    assert is_best(row(0.0, -30.0), [{"step": 1}])
    assert not is_best({"step": 1}, [])


def test_rows_beyond_the_checkpoint_are_of_an_attempt_that_was_cut_off(
    tmp_path: Path,
) -> None:
    with RunLog(tmp_path, "step", 0, ()) as log:
        for step in (10, 20, 30):
            log.add(row(0.5, -1.0, step))
    with (tmp_path / METRICS).open("a") as file:
        file.write('{"step": 40, "succ')
    assert [kept["step"] for kept in read_metrics(tmp_path)] == [10, 20, 30]
    assert [kept["step"] for kept in RunLog(tmp_path, "step", 20, ()).rows] == [10, 20]
    assert [kept["step"] for kept in read_metrics(tmp_path)] == [10, 20]
    with pytest.raises(CheckpointError, match=r"ends at step 20, the checkpoint .* 25"):
        RunLog(tmp_path, "step", 25, ())
    with pytest.raises(CheckpointError, match="has a row without episode"):
        RunLog(tmp_path, "episode", 0, ())


@pytest.mark.parametrize(
    ("data", "match"),
    [
        ("{}\n" * 8_000_000, "a row without values, or more than"),
        ('{"a": 1}\n' * 100_001, "more than 100,000 rows"),
        (json.dumps({str(n): 1 for n in range(1_001)}) + "\n", "1,000 names"),
        ('{"a": 1, "b": 2}\n' * 1_000 + "[1]\n", "dict"),
        ('{"a": "x"}\n', "is neither float or int"),
        ('{"\\u001b[31m": 1}\n', "control characters"),
        (" " * 200_000 + "{}\n", "a line of more than 100,000 bytes"),
    ],
)
def test_records_that_cannot_be_ours_are_refused(
    tmp_path: Path, data: str, match: str
) -> None:
    (tmp_path / METRICS).write_text(data)
    with pytest.raises(CheckpointError, match=match):
        read_metrics(tmp_path)


def test_a_record_that_is_a_link_out_is_refused_and_left_alone(tmp_path: Path) -> None:
    run, victim = tmp_path / "run", tmp_path / "victim.jsonl"
    run.mkdir()
    victim.write_text('{"step": 1}\n')
    (run / METRICS).symlink_to(victim)
    with pytest.raises(CheckpointError, match="is a link out of its folder"):
        RunLog(run, "step", 0, ())
    assert victim.read_text() == '{"step": 1}\n'
