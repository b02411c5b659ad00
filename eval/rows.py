"""Rows of results as CSV, and back."""

import csv
import gzip
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from marl_mm.errors import UsageError
from marl_mm.eval.metrics import Row
from marl_mm.files import new_file


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as CSV, compressed if the name ends in .gz.

    Numbers have six significant digits, intervals two columns; what only some rows have
    is empty in the others.
    """
    flat = [_spread(row) for row in rows]
    text = io.StringIO(newline="")
    names = list(dict.fromkeys(name for row in flat for name in row))
    writer = csv.DictWriter(text, fieldnames=names)
    writer.writeheader()
    writer.writerows(flat)
    data = text.getvalue().encode()
    if path.suffix == ".gz":
        data = gzip.compress(data, mtime=0)  # no clock in the bytes
    with new_file(path) as temporary:
        temporary.write_bytes(data)


def _spread(row: Row) -> dict[str, str]:
    flat: dict[str, str] = {}
    for name, value in row.items():
        if isinstance(value, list | tuple):
            for end, bound in zip(("low", "high"), value, strict=True):
                flat[f"{name}_{end}"] = f"{bound:.6g}"
        else:
            flat[name] = f"{value:.6g}" if isinstance(value, float) else str(value)
    return flat


def as_read(rows: Sequence[Row]) -> list[Row]:
    """Rows as they are read back from a file, with six digits."""
    return [_typed(_spread(row)) for row in rows]


def to_json(values: Any) -> str:
    """Rows as JSON, where null is what could not be measured."""
    return json.dumps(_or_null(values), indent=2)


def _or_null(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_or_null(item) for item in value]
    if isinstance(value, dict):
        return {name: _or_null(item) for name, item in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


def read_rows(path: Path) -> list[Row]:
    """Rows of a CSV file of ours, compressed or not, with numbers and pairs.

    Raises:
        UsageError: If there is no such file.
    """
    if not path.exists():
        raise UsageError(f"there is no {path} to draw from")
    opened = (
        gzip.open(path, "rt", newline="")
        if path.suffix == ".gz"
        else path.open(newline="")
    )
    with opened as file:
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
