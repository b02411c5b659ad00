"""The README's tables, made of the committed results.

``python -m marl_mm.eval.readme`` in a clone writes them anew between their marks; a
test holds that this changes nothing.
"""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from marl_mm.eval.metrics import Row
from marl_mm.eval.sweep import responses
from marl_mm.eval.tables import (
    abuse_table,
    alpha_table,
    bench_table,
    response_table,
    worth_table,
)
from marl_mm.files import new_file

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "eval" / "results"


def filled(text: str) -> str:
    """The text with every table between ``<!-- name -->`` and ``<!-- /name -->``."""
    for name, make in TABLES.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
        before, found, rest = text.partition(begin)
        if found:
            text = before + begin + make() + end + rest.partition(end)[2]
    return text


def read_rows(path: Path) -> list[Row]:
    """Rows of a CSV file of ours, numbers as numbers, intervals as pairs."""
    with path.open(newline="") as file:
        return [_typed(row) for row in csv.DictReader(file)]


def _typed(row: dict[str, str]) -> Row:
    values = {name: _number(text) for name, text in row.items()}
    for name in [name for name in values if name.endswith("_low")]:
        stem = name.removesuffix("_low")
        values[stem] = [values.pop(name), values.pop(f"{stem}_high")]
    return values


def _number(text: str) -> Any:
    try:
        return int(text)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError:
        return text


def _alpha() -> str:
    return alpha_table(read_rows(RESULTS / "alpha/alpha.csv"), "Reach-v0", "blend")


def _responses() -> str:
    return response_table(responses(read_rows(RESULTS / "alpha/alpha.csv")))


def _worth() -> str:
    return worth_table(read_rows(RESULTS / "alpha/worth.csv"))


def _bench() -> str:
    return bench_table(json.loads((RESULTS / "controller/bench.json").read_text()))


def _abuse() -> str:
    forms = ("blend", "rhp")
    paths = {form: RESULTS / f"controller/abuse-{form}.json" for form in forms}
    return abuse_table({f: json.loads(path.read_text()) for f, path in paths.items()})


TABLES: dict[str, Callable[[], str]] = {
    "alpha": _alpha,
    "responses": _responses,
    "worth": _worth,
    "bench": _bench,
    "abuse": _abuse,
}
"""Name of the marks, and what stands between them."""


def main() -> None:
    """Write the README's tables anew."""
    path = ROOT / "README.md"
    text = filled(path.read_text())
    with new_file(path) as temporary:
        temporary.write_text(text)


if __name__ == "__main__":
    main()
