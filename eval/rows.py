"""Rows of results as CSV, and back."""

import csv
import gzip
import io
import json
import lzma
import math
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from marl_mm.errors import MarlMmError, UsageError
from marl_mm.eval.metrics import Row
from marl_mm.files import new_file
from marl_mm.received import check_plain, check_regular, most_unpacked

_XZ = (
    {
        "id": lzma.FILTER_LZMA2,
        "preset": 9 | lzma.PRESET_EXTREME,
        "dict_size": 2**20,  # longer than files of rows; the preset's takes 700 MB
        "lc": 2,  # with pb, 1 % less for digits
        "pb": 0,
    },
)
"""Filters of ``lzma`` for text that is mostly digits."""

_XZ_MEMORY = 100_000_000
"""Most memory for unpacking [bytes]."""


_ROWS_BYTES = 32_000_000
"""Largest size of unpacked rows [bytes]; ours have less than a million."""

_CELLS = 1_000_000
"""Largest number of cells in a file of rows; ours have less than 180,000."""

_ROW_CELLS = 5
"""Number of cells whose memory a row takes by itself."""

MOST_COLUMNS = 1_000
"""Largest number of columns; ours have less than 30."""


def older_file(path: Path) -> Path:
    """Name that rows in a file ``.csv.xz`` had in older results: ``.csv.gz``."""
    return path.with_suffix(".gz")


def has_rows(path: Path) -> bool:
    """Whether ``read_rows`` finds a file there, under its name or its older one."""
    return path.exists() or (path.suffix == ".xz" and older_file(path).exists())


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as CSV, compressed if the name ends in .xz or .gz.

    Numbers have six significant digits, intervals two columns; what only some rows have
    is empty in the others. A file ``.csv.xz`` replaces the older ``.csv.gz``.
    """
    flat = [_spread(row) for row in rows]
    text = io.StringIO(newline="")
    names = list(dict.fromkeys(name for row in flat for name in row))
    writer = csv.DictWriter(text, fieldnames=names)
    writer.writeheader()
    writer.writerows(flat)
    data = text.getvalue().encode()
    if path.suffix == ".xz":
        data = lzma.compress(data, check=lzma.CHECK_CRC32, filters=_XZ)
    elif path.suffix == ".gz":
        data = gzip.compress(data, mtime=0)  # no clock in the bytes
    with new_file(path) as temporary:
        temporary.write_bytes(data)
    if path.suffix == ".xz":
        older_file(path).unlink(missing_ok=True)


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
    cells = ({name: [text] for name, text in _spread(row).items()} for row in rows)
    return [row for columns in cells for row in _typed(columns)]


def to_json(values: Any) -> str:
    """Rows as JSON, where null is what could not be measured, or is infinite."""
    return json.dumps(_or_null(values), indent=2)


def _or_null(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_or_null(item) for item in value]
    if isinstance(value, dict):
        return {name: _or_null(item) for name, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_rows(path: Path) -> list[Row]:
    """Rows of a CSV file of ours, compressed or not, with numbers and pairs.

    Where there is no ``.csv.xz``, the older ``.csv.gz`` is read.

    Raises:
        UsageError: If there is no such file.
        MarlMmError: If it is damaged.
    """
    if not has_rows(path):
        raise UsageError(f"there is no {path} to draw from")
    if not path.exists():
        path = older_file(path)
    size = check_regular(path, MarlMmError, _ROWS_BYTES)
    most = min(most_unpacked(size), _ROWS_BYTES)
    try:
        data = _unpacked(path, most)
        if data.count(b",") + _ROW_CELLS * data.count(b"\n") > _CELLS:
            raise ValueError(f"more than {_CELLS:,} cells")
        check_plain(data.decode().replace("\r\n", "\n"), "it", MarlMmError)
        return _typed(_columns(data))
    except _DAMAGE as error:
        reason = str(error) or type(error).__name__
        raise MarlMmError(f"{path} is damaged ({reason:.120})") from error


def _columns(data: bytes) -> dict[str, Sequence[str]]:
    """Texts of a CSV file's bytes by column."""
    if not data:
        raise ValueError("it is empty")
    file = io.TextIOWrapper(io.BytesIO(data), "utf-8", newline="")
    names, *lines = csv.reader(file, strict=True)
    if len(names) > MOST_COLUMNS:
        raise ValueError(f"{len(names):,} columns, expected at most {MOST_COLUMNS:,}")
    for name, count in Counter(names).most_common(1):
        if count > 1:
            raise ValueError(f"{count} columns of the name {name:.40}")
    lines = [line for line in lines if line]
    for number, line in enumerate(lines, 1):
        if len(line) != len(names):
            raise ValueError(f"row {number} has not as many values as the first")
    return dict(zip(names, zip(*lines, strict=True), strict=False))  # none of no lines


_DAMAGE = (
    *(OSError, EOFError, ValueError, KeyError, MemoryError),
    *(csv.Error, zlib.error, lzma.LZMAError, MarlMmError),
)
"""Exceptions that reading damaged rows raises."""


def _unpacked(path: Path, most: int) -> bytes:
    """A file's bytes, unpacked if it is compressed."""
    packed = path.read_bytes()
    if path.suffix not in (".xz", ".gz"):
        return packed
    unpacker: Any = zlib.decompressobj(wbits=31)
    if path.suffix == ".xz":
        unpacker = lzma.LZMADecompressor(memlimit=_XZ_MEMORY)
    data: bytes = unpacker.decompress(packed, most)
    if not unpacker.eof:
        raise ValueError(f"cut off, or more than {most:,} bytes unpacked")
    return data


def _typed(columns: Mapping[str, Sequence[str]]) -> list[Row]:
    """Rows with numbers and pairs, of texts by column."""
    values: dict[str, list[Any]] = {}
    for name, texts in columns.items():
        known = {text: _number(text) for text in set(texts)}  # most come many times
        values[name] = [known[text] for text in texts]
    stems = [n.removesuffix("_low") for n in values if n.endswith("_low")]
    for stem in [stem for stem in stems if f"{stem}_high" in values]:
        values[stem] = list(
            map(
                list,
                zip(values.pop(f"{stem}_low"), values.pop(f"{stem}_high"), strict=True),
            )
        )
    return [
        dict(zip(values, row, strict=True))
        for row in zip(*values.values(), strict=True)
    ]


def _number(text: str) -> Any:
    if text[:1].isalpha() and text[0] not in "iInN":  # infinity and nan are numbers
        return text
    try:
        if "." not in text:
            return int(text)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError:
        return text
