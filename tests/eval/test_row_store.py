"""Rows of a study that somebody sent: what is not there is named, not looked for."""

import gzip
import json
from pathlib import Path

import pytest

from marl_mm.errors import MarlMmError
from marl_mm.eval.studies.rows import RowStore
from marl_mm.eval.studies.run_rows import is_probed
from marl_mm.eval.studies.settings import LAST
from marl_mm.eval.studies.study import cell_name
from marl_mm.eval.studies.targets import STUDIES
from marl_mm.files import write_json

CELL = STUDIES["table4"].cells[0]


def store(folder: Path, end: str, text: str) -> RowStore:
    source, setting = cell_name(CELL)
    path = folder / source.replace("/", "-") / f"{setting}{end}"
    path.parent.mkdir(parents=True)
    path.write_bytes(text.encode())
    return RowStore(folder)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("probe,goal\nlast,0\n", "row 1 has no seed"),
        ("seed,goal\n0,0\n", "row 1 has no probe"),
        ("seed,probe\n0,last\nx,last\n", "row 2 has no seed"),
        ("seed_low,seed_high,probe\n0,1,last\n", "row 1 has no seed"),
        ("seed,probe_low,probe_high\n0,0,1\n", "row 1 has no probe"),
    ],
)
def test_rows_without_what_finds_them_are_named(
    tmp_path: Path, text: str, match: str
) -> None:
    rows = store(tmp_path, ".csv.gz", "")
    (path,) = tmp_path.rglob("*.csv.gz")
    path.write_bytes(gzip.compress(text.encode()))
    with pytest.raises(MarlMmError, match=match):
        rows.evaluations(CELL, [0], [])


@pytest.mark.parametrize(
    ("ends", "match"),
    [([1], "list"), ({"0": "x"}, "float"), ({"x": 1}, "`diverged` is not by seed")],
)
def test_records_whose_seeds_are_none_are_named(
    tmp_path: Path, ends: object, match: str
) -> None:
    rows = store(tmp_path, ".json", json.dumps({"diverged": ends}))
    with pytest.raises(MarlMmError, match=match):
        rows.diverged(CELL)


def test_an_evaluation_of_other_goals_or_settings_is_made_anew(tmp_path: Path) -> None:
    assert not is_probed(tmp_path, LAST, 2, {})
    kept = {"episodes": [{}, {}], "overrides": {"max_steps": 5}, "probe": LAST.way}
    write_json(LAST.file(tmp_path), kept)
    assert is_probed(tmp_path, LAST, 2, {"max_steps": 5})
    for goals, overrides in ((3, {"max_steps": 5}), (2, {"max_steps": 6}), (2, {})):
        assert not is_probed(tmp_path, LAST, goals, overrides)
