"""Rows of results are read back as they were written, under older names too."""

import gzip
import lzma
import math
from collections.abc import Callable
from pathlib import Path

import pytest

from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.grouping import by_goal
from marl_mm.eval.metrics import Row
from marl_mm.eval.rows import has_rows, read_rows, write_csv

ROWS: list[Row] = [{"name": "a", "goals": 3, "share": 0.25, "interval": [0.1, 0.5]}]


@pytest.mark.parametrize("end", (".csv", ".csv.xz", ".csv.gz"))
def test_rows_are_read_back_as_they_were_written(end: str, tmp_path: Path) -> None:
    first, second = tmp_path / f"first{end}", tmp_path / f"second{end}"
    for path in (first, second):
        write_csv(path, ROWS)
        assert read_rows(path) == ROWS
    assert first.read_bytes() == second.read_bytes()  # no clock, no name


def test_older_files_are_read_until_newer_ones_replace_them(tmp_path: Path) -> None:
    path, older = tmp_path / "rows.csv.xz", tmp_path / "rows.csv.gz"
    assert not has_rows(path)
    with pytest.raises(UsageError, match=r"there is no .*rows\.csv\.xz to draw from"):
        read_rows(path)
    older.write_bytes(gzip.compress(b"name,goals\na,3\n"))
    assert has_rows(path)
    assert read_rows(path) == [{"name": "a", "goals": 3}]
    write_csv(path, ROWS)
    assert [file.name for file in tmp_path.iterdir()] == ["rows.csv.xz"]
    assert read_rows(path) == ROWS


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (b"", "it is empty"),
        (b"a,a\n1,2\n", "2 columns of the name a"),
        (b"a\n" * 12_000_000, "more than 1,000,000 cells"),
        (b"ab," * 3_300_000, "more than 1,000,000 cells"),
        (b",".join(b"%d" % n for n in range(1_001)), "1,001 columns"),
        (b"a\n" + b"ab," * 900_000 + b"\n", "not as many values as the first"),
        (b"a" * 33_000_000, "33,000,000 bytes, expected at most 32,000,000"),
    ],
)
def test_rows_that_cannot_be_ours_are_refused_before_they_are_parsed(
    tmp_path: Path, data: bytes, match: str
) -> None:
    path = tmp_path / "rows.csv"
    path.write_bytes(data)
    with pytest.raises(MarlMmError, match=match):
        read_rows(path)


@pytest.mark.parametrize("pack", [lzma.compress, gzip.compress])
def test_rows_that_unpack_to_far_more_are_refused(
    tmp_path: Path, pack: Callable[[bytes], bytes]
) -> None:
    path = tmp_path / f"rows.csv.{'xz' if pack is lzma.compress else 'gz'}"
    path.write_bytes(pack(b"a\n" * 20_000_000))
    with pytest.raises(MarlMmError, match="more than 32,000,000 bytes unpacked"):
        read_rows(path)


def test_a_column_may_end_like_half_of_an_interval(tmp_path: Path) -> None:
    rows = [{"battery_low": 0.2, "return": [1.0, 2.0]}]
    write_csv(tmp_path / "rows.csv.xz", rows)
    assert read_rows(tmp_path / "rows.csv.xz") == rows


def test_numbers_are_read_as_such_and_texts_as_texts(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    texts = ("1", "-2", "0.5", "1e3", "nan", "-inf", "Infinity", "east", "i", "", "1.x")
    path.write_text(f"{','.join(map(str, range(11)))}\n{','.join(texts)}\n")
    values = list(read_rows(path)[0].values())
    expected = [1, -2, 0.5, 1e3, math.nan, -math.inf, math.inf, "east", "i", "", "1.x"]
    assert list(map(repr, values)) == list(map(repr, expected))


def test_only_rows_of_the_same_goals_are_paired() -> None:
    rows = [
        {"seed": seed, "goal": goal, "success": float(goal == seed)}
        for seed, goal in ((1, 1), (0, 0), (1, 0), (0, 1))
    ]
    assert by_goal(rows, "success").tolist() == [1, 0, 0, 1]
    twice = [row | {"goal": 1} for row in rows]
    other = [row | {"goal": row["goal"] + row["seed"]} for row in rows]
    for damaged in (rows[1:], twice, other):
        with pytest.raises(MarlMmError, match="do not all have the same goals, each"):
            by_goal(damaged, "success")
