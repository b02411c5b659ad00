"""The README's tables, made of the committed results.

``python -m marl_mm.eval.readme`` in a clone writes them anew between their marks; a
test holds that this changes nothing.
"""

import json
from collections.abc import Callable
from pathlib import Path

from marl_mm.eval.bench_tables import abuse_table, bench_table, data_table
from marl_mm.eval.online import SETTINGS
from marl_mm.eval.online_tables import online_table
from marl_mm.eval.rows import read_rows
from marl_mm.eval.sweep import responses
from marl_mm.eval.sweep_tables import alpha_table, response_table, worth_table
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


def _data() -> str:
    return data_table(json.loads((RESULTS / "data/bench.json").read_text()))


def _online() -> str:
    return online_table(read_rows(RESULTS / "online/online.csv"), SETTINGS)


TABLES: dict[str, Callable[[], str]] = {
    "alpha": _alpha,
    "responses": _responses,
    "worth": _worth,
    "bench": _bench,
    "abuse": _abuse,
    "data": _data,
    "online": _online,
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
