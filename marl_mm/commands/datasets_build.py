"""Commands that build named datasets, list them, and rebuild one from its card."""

import sys
from typing import Any

import tyro

from marl_mm.commands.options import CORES
from marl_mm.commands.output import print_rows, show
from marl_mm.commands.wording import as_options
from marl_mm.errors import DatasetError
from marl_mm.progress import progress_bars
from marl_mm.runs.rebuilding import read_card, rebuild
from marl_mm.runs.recipes import (
    build_dataset,
    catalogue_rows,
    named_card,
    refuse_unknown,
)
from marl_mm.runs.settings import check_positive


def build_named(
    names: tyro.conf.Positional[tuple[str, ...]],
    *,
    workers: int = CORES,
    json: bool = False,
) -> None:
    """Build named datasets, and say whether they are those on record, to the bit.

    After Ctrl-C, the same command goes on. Exit code 1 if one is another.

    Args:
        names: Names of recipes, such as quiet-zone-noisy; see "marl-mm datasets
            catalogue".
        workers: Processes that collect; the datasets do not depend on their number.
        json: Print JSON.
    """
    check_positive(workers=workers)
    refuse_unknown(names)
    rows, others = {}, []
    with progress_bars(vanish=True) as bar:
        for name in names:
            built = build_dataset(name, workers=workers, progress=bar, notify=_notify)
            rows[name] = built.row | {"verdict": built.verdict}
            if built.differs:
                others.append(name)
            if not json:
                print(f"{built.recipe.source.name}: {built.verdict}", flush=True)
    if json:
        show(rows)
    if others:
        raise DatasetError(f"not as on record: {', '.join(others)}")


def list_named(
    names: tyro.conf.Positional[tuple[str, ...]] = (), *, json: bool = False
) -> None:
    """List the named datasets that can be built, or show the cards of some.

    Args:
        names: Names of recipes whose cards are shown; default a table of all.
        json: Print the cards as JSON, with the whole SHA-256 of the data.
    """
    cards = [named_card(name) for name in names] or catalogue_rows()
    if json:
        show(cards)
    elif names:
        print("\n\n".join(map(_card_text, cards)))
    else:
        print_rows(list(map(_row, cards)), json, "recipes")


def _row(card: dict[str, Any]) -> dict[str, Any]:
    """A card's line in the table of all."""
    share = card["success"]
    return {
        **{name: card[name] for name in ("name", "task", "steps", "episodes")},
        "success": "" if share is None else f"{100 * share:.1f} %",
        "ships": "yes" if card["ships"] else "",
        "data": card["data"],
    }


def _card_text(card: dict[str, Any]) -> str:
    settings = ", ".join(f"{name} {value}" for name, value in card["settings"].items())
    texts = card | {"settings": settings or "the defaults"}
    return "\n".join(
        f"{name.replace('_', ' '):<12}{'-' if value is None else value}"
        for name, value in texts.items()
    )


def rebuild_card(
    card: tyro.conf.Positional[str], *, workers: int = CORES, json: bool = False
) -> None:
    """Collect a card's dataset again, elsewhere, and compare the data's SHA-256.

    Exit code 1 if it is another.

    Args:
        card: File card.json of a collected dataset, which "marl-mm datasets build" and
            "show" keep with it, or the dataset's id, name or path.
        workers: Processes that collect; the dataset does not depend on their number.
        json: Print JSON.
    """
    check_positive(workers=workers)
    read = read_card(card)
    with progress_bars(vanish=True) as bar:
        expected, actual = rebuild(read, workers=workers, progress=bar)
    same = expected == actual
    text = f"{card}: the same data, SHA-256 {actual}"
    if same or json:
        show({"on_card": expected, "rebuilt": actual, "same": same}, text, json)
    if not same:
        differing = ", ".join(read.differing_packages)
        differing = differing or "none, so that code, processor or card is another"
        raise DatasetError(
            f"{card} has data of SHA-256 {expected}, rebuilt they have {actual}; "
            f"packages that differ: {differing}"
        )


def _notify(text: str) -> None:
    print(as_options(text), file=sys.stderr)
