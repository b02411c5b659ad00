"""Rows of results are read back as they were written, under older names too."""

import gzip
from pathlib import Path

import pytest

from marl_mm.errors import UsageError
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
