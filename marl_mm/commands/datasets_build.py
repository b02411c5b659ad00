"""Commands that build named datasets, list them, and rebuild one from its card."""

import sys
from pathlib import Path

import tyro

from marl_mm.commands.options import CORES
from marl_mm.commands.output import print_rows, show
from marl_mm.commands.wording import as_options
from marl_mm.errors import DatasetError
from marl_mm.progress import progress_bars
from marl_mm.runs.recipes import (
    build,
    catalogue_rows,
    differing_packages,
    rebuild,
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
            built = build(name, workers=workers, progress=bar, notify=_notify)
            rows[name] = built.row | {"verdict": built.verdict}
            if built.differs:
                others.append(name)
            if not json:
                print(f"{built.recipe.source.name}: {built.verdict}", flush=True)
    if json:
        show(rows)
    if others:
        raise DatasetError(f"not as on record: {', '.join(others)}")


def list_named(*, json: bool = False) -> None:
    """List the named datasets that can be built: task, kind of data, hashes on record.

    Args:
        json: Print JSON, with the whole SHA-256 of the data.
    """
    rows = catalogue_rows()
    if not json:
        for row in rows:
            row["data_sha256"] = (row["data_sha256"] or "")[:12]
            share = row["success"]
            row["success"] = "" if share is None else f"{100 * share:.1f} %"
            del row["id"]
    print_rows(rows, json, "recipes")


def rebuild_card(
    card: tyro.conf.Positional[Path], *, workers: int = CORES, json: bool = False
) -> None:
    """Collect a card's dataset again, elsewhere, and compare the data's SHA-256.

    Exit code 1 if it is another.

    Args:
        card: File card.json of a collected dataset, which "marl-mm datasets show"
            keeps with it.
        workers: Processes that collect; the dataset does not depend on their number.
        json: Print JSON.
    """
    check_positive(workers=workers)
    with progress_bars(vanish=True) as bar:
        expected, actual = rebuild(card, workers=workers, progress=bar)
    same = expected == actual
    text = f"{card}: the same data, SHA-256 {actual}"
    if same or json:
        show({"on_card": expected, "rebuilt": actual, "same": same}, text, json)
    if not same:
        differing = ", ".join(differing_packages(card)) or "none: another processor"
        raise DatasetError(
            f"{card} has data of SHA-256 {expected}, rebuilt they have {actual}; "
            f"packages that differ: {differing}"
        )


def _notify(text: str) -> None:
    print(as_options(text), file=sys.stderr)
