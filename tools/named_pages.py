"""The page of the named datasets: a card of each, of its recipe and of the record."""

from collections.abc import Callable
from typing import Any

from marl_mm.eval.tables import markdown_table
from marl_mm.runs.recipes import RECIPES, catalogue_rows, named_card


def other_named() -> str:
    """How many named datasets do not ship, as a sentence."""
    number = sum(not card["ships"] for card in catalogue_rows())
    return (
        f"{number} more [named datasets](named.md) are built, by `marl-mm datasets "
        "build NAME`.\n"
    )


def recipes_table() -> str:
    """Named datasets, and what they are, as Markdown."""
    lines = []
    for row in catalogue_rows():
        reached, sha = row["success"], row["data_sha256"]
        lines.append(
            (
                f"`{row['name']}`",
                row["data"],
                *("" if row[k] is None else str(row[k]) for k in ("steps", "episodes")),
                "" if reached is None else f"{100 * reached:.1f}",
                f"`{sha[:12]}`" if sha else "not on record yet",
            )
        )
    header = ("name", "data", "steps", "episodes", "reached [%]", "SHA-256")
    return markdown_table(header, lines)


def _page() -> str:
    cards = "\n".join(map(_section, RECIPES.names()))
    return (
        "# Cards of the named datasets\n\n"
        "**What each named dataset is made of, and what came of it: `marl-mm datasets "
        "build NAME` says whether yours is that.** The SHA-256 is of the data file. "
        "`marl-mm datasets catalogue NAME` prints the same card, and `marl-mm datasets "
        "show NAME` the longer one of a dataset that is built, with returns, alphas and "
        "coverage. On which task a study tests what is learnt from one is the study's "
        f"choice.\n\n{cards}"
    )


def _section(name: str) -> str:
    card = named_card(name)
    settings = ", ".join(f"{key} {value}" for key, value in card["settings"].items())
    by = f"`{card['collector']}`, {settings or 'its defaults'}; seed {card['seed']}"
    ships = "; ships with the package" * card["ships"]
    rows = [
        ("id", f"{card['id']}{ships}"),
        ("data", f"{card['axis']}: {card['data']}"),
        ("task", f"`{card['task']}`, {card['engine']}"),
        ("collector", by),
        ("size", _size(card)),
        ("SHA-256", f"`{card['data_sha256']}`"),
        ("made with", card["packages"]),
        ("build", f"`{card['build']}`"),
    ]
    return f"## {name}\n\n{markdown_table(('', ''), rows)}"


def _size(card: dict[str, Any]) -> str:
    if card["episodes"] is None:
        return f"{card['steps']:,} steps, not on record yet"
    return (
        f"{card['steps']:,} steps in {card['episodes']:,} episodes, "
        f"{100 * card['success']:.1f} % of which reach the goal"
    )


PAGES: dict[str, Callable[[], str]] = {"reference/datasets/named.md": _page}
"""Path below docs/, and what makes the page."""
