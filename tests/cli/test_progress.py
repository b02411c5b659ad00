"""Progress: numbers stay whole, whatever the line's width."""

import re
from typing import Any

import pytest

from marl_mm.progress import progress_bars


@pytest.mark.parametrize("width", [70, 80, 200])
def test_numbers_are_not_cut_off(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    with progress_bars() as bar:
        advance: Any = bar("a label that is longer than most of them", 180_000)
        advance(104_900, "and a note, too: critic 0.0213, actor -1.53")
    (line,) = capsys.readouterr().err.splitlines()
    assert len(line) <= width
    assert re.search(r" 104900/180000 +\d:\d\d:\d\d +left ", line)


@pytest.mark.parametrize("vanish", [False, True])
def test_full_bars_vanish_where_that_is_asked_for(
    vanish: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with progress_bars(vanish) as bar:
        full, half = bar("first", 2), bar("second", 2)
        full(1, "")
        full(1, "")
        half(1, "")
    shown = capsys.readouterr().err
    assert ("first" in shown) == (not vanish) and "second" in shown
