"""Rows fit the terminal: as a table, or as a list where its words would be broken."""

import io
from typing import Any

import pytest
from rich.console import Console

from marl_mm.terminal import table_or_list

ROWS: list[dict[str, Any]] = [
    {
        "id": f"marl_mm/quiet-zone/expert-{number}-v0",
        "engine": "mujoco",
        "about": "Reach a goal behind, with a base that is quiet within zones.",
        "agents": ["end_effector", "balance"],
        "numbers": {"zone_limit": 0.2, "max_steps": 25},
        "note": None,
    }
    for number in range(3)
]

WORDS = ["marl_mm/quiet-zone/expert-2-v0", "mujoco", "end_effector,", "zone_limit"]


def printed(rows: list[dict[str, Any]], title: str | None, width: int) -> str:
    console = Console(width=width, file=io.StringIO())
    console.print(table_or_list(rows, title, width))
    return console.file.getvalue()  # type: ignore[attr-defined,no-any-return]


@pytest.mark.parametrize("width", [31, 60, 80, 120, 240])
def test_no_word_is_broken_at_any_width(width: int) -> None:
    text = printed(ROWS, "below here", width)
    assert "below here" in text
    assert max(map(len, text.splitlines())) <= width
    for word in WORDS:
        assert text.count(word) == (1 if "2-v0" in word else 3)
    assert "note" not in text  # which no row has
    assert ("┃" in text) == (width >= 120)


@pytest.mark.parametrize("width", [10, 200])
def test_a_strangers_text_draws_nothing(width: int) -> None:
    rows = [{"id": "a", "about": "\x1b[31m[red]b\nc"}]
    text = printed(rows, "t\x1b[2J", width)
    assert "\x1b" not in text
    assert "[red]b" in text
