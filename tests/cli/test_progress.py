"""Progress: numbers stay whole, whatever the line's width."""

import re
import time
from multiprocessing import get_context
from typing import Any

import pytest

from marl_mm.progress import Advance, distant_bars, progress_bars, show_distant_bars


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


def test_of_bars_without_work_an_error_leaves_nothing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(ValueError, match="too late"), progress_bars() as bar:
        bar("first", 2)
        raise ValueError("too late")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("error", "ends"), [(BrokenPipeError(), False), (ValueError("odd"), True)]
)
def test_a_bar_that_fails_ends_distant_work_unless_nobody_reads_it(
    error: Exception, ends: bool
) -> None:
    context = get_context("forkserver")
    messages, stop = context.Queue(), context.Event()

    def bar(label: str, total: int) -> Advance:
        raise error

    def work() -> None:
        with show_distant_bars(messages, stop, bar):
            advance: Any = distant_bars(messages, stop)("first", 2)
            until = time.monotonic() + 30
            while ends and time.monotonic() < until:  # Ctrl-C, as for the worker
                time.sleep(0.01)
                advance(0, "")
            advance(2, "")

    if ends:
        with pytest.raises(ValueError, match="odd"):
            work()
    else:
        work()
    assert stop.is_set() == ends
