"""Hostile files: damage to copies of good ones, at random but seeded.

Some change bytes. Others know the format: they change a value, a type or a shape and
compute all checksums anew, as somebody would who means harm.
"""

import csv
import gzip
import io
import json
import lzma
import os
import sqlite3
import warnings
import zipfile
from collections.abc import Callable, Sequence
from contextlib import closing
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch
from safetensors.torch import load_file, save_file

from marl_mm.algorithms.checkpoint import FILE as CHECKPOINT
from marl_mm.algorithms.pretrained import WEIGHTS
from marl_mm.datasets.hdf5 import FILE as DATA
from marl_mm.datasets.journal import FILE as JOURNAL
from marl_mm.datasets.metadata import sign_metadata
from marl_mm.errors import DatasetError, UsageError
from marl_mm.received import file_digest

Rng = np.random.Generator

Change = Callable[[Path, Rng], str]
"""Changes a file or folder; returns what it did, in words."""


@dataclass(frozen=True)
class Mutation:
    """What was done to a copy."""

    about: str
    """Description."""

    plausible: bool
    """Whether the contents may be accepted: checksums are right, or there are none."""


def mutate(path: Path, rng: Rng) -> Mutation:
    """Change a copy of a good file or folder in one way.

    Args:
        path: File or folder, which is changed.
        rng: Random numbers that choose the way and the place.

    Raises:
        UsageError: If there is nothing in it that could be changed.
    """
    files = sorted(p for p in [path, *path.rglob("*")] if _is_target(p))
    if not files:
        raise UsageError(f"{path} has no files to change")
    target = _drawn(files, rng)
    informed = _INFORMED.get(target.suffix)
    if informed is not None and rng.random() < _INFORMED_SHARE:
        about = informed(target, rng)
        _sign(path)
        return Mutation(f"{target.name}: {about}", True)
    bare = target.suffix in _WITHOUT_CHECKSUM and target.name != "metadata.json"
    change = _drawn(_CHANGES, rng)
    about = f"{target.name}: {change(target, rng)}"
    return Mutation(about, bare or change is _missing)


_INFORMED_SHARE = 0.6
"""Share of mutations that know the format, where there are some."""


_ELSEWHERE = "/proc/version"
"""File beside the mutated ones that links lead to; nobody can write to it."""

_WITHOUT_CHECKSUM = (".json", ".jsonl", ".csv")
"""Suffixes of texts without a checksum, but for the metadata of datasets."""


def _is_target(path: Path) -> bool:
    """Whether a file is read, and not empty: cards, pictures and events are not."""
    readable = path.suffix in (*_INFORMED, ".onnx")
    read = readable and not path.name.startswith("card.")
    return read and path.is_file() and path.stat().st_size > 0


def _sign(path: Path) -> None:
    """Compute a dataset's checksums anew."""
    metadata, data = path / "data" / "metadata.json", path / "data" / DATA
    if not metadata.exists():
        return
    try:
        values = json.loads(metadata.read_text("utf-8"))
        if data.is_file() and "data_sha256" in values["marl_mm"]:
            values["marl_mm"]["data_sha256"] = file_digest(data, DatasetError)
            metadata.write_text(json.dumps(values), "utf-8")
        sign_metadata(metadata)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass  # it is too damaged to be signed


def _drawn(values: Sequence[Any], rng: Rng) -> Any:
    return values[int(rng.integers(len(values)))]


# --- Bytes -------------------------------------------------------------------


def _flip(path: Path, rng: Rng) -> str:
    content = bytearray(path.read_bytes())
    place, bit = int(rng.integers(len(content))), int(rng.integers(8))
    content[place] ^= 1 << bit
    path.write_bytes(content)
    return f"bit {bit} of byte {place}"


def _cut(path: Path, rng: Rng) -> str:
    left = int(rng.integers(path.stat().st_size))
    os.truncate(path, left)
    return f"cut to {left} bytes"


def _zeros(path: Path, rng: Rng) -> str:
    content = bytearray(path.read_bytes())
    begin = int(rng.integers(len(content)))
    end = min(len(content), begin + int(rng.integers(1, 512)))
    content[begin:end] = bytes(end - begin)
    path.write_bytes(content)
    return f"zeros from {begin} to {end}"


def _noise(path: Path, rng: Rng) -> str:
    content = bytearray(path.read_bytes())
    begin = int(rng.integers(len(content)))
    end = min(len(content), begin + int(rng.integers(1, 512)))
    content[begin:end] = rng.bytes(end - begin)
    path.write_bytes(content)
    return f"noise from {begin} to {end}"


def _more(path: Path, rng: Rng) -> str:
    with path.open("ab") as file:
        file.write(rng.bytes(int(rng.integers(1, 4096))))
    return "bytes at the end"


def _pipe(path: Path, rng: Rng) -> str:
    path.unlink()
    os.mkfifo(path)
    return "a pipe in its place"


def _device(path: Path, rng: Rng) -> str:
    path.unlink()
    path.symlink_to("/dev/zero")
    return "a link to a device in its place"


def _folder(path: Path, rng: Rng) -> str:
    path.unlink()
    path.mkdir()
    return "a folder in its place"


def _link(path: Path, rng: Rng) -> str:
    path.unlink()
    path.symlink_to(_ELSEWHERE)
    return "a link to another file in its place"


def _missing(path: Path, rng: Rng) -> str:
    path.unlink()
    return "missing"


_CHANGES: Sequence[Change] = (
    *(_flip, _flip, _flip, _cut, _cut, _zeros, _noise, _noise, _more),
    *(_pipe, _device, _folder, _link, _missing),
)
"""Changes of any file, the commoner ones several times."""


# --- Values of records -------------------------------------------------------

_VALUES: Sequence[Any] = (
    *(None, True, 0, -1, 1.5, 1e308, float("nan"), float("inf"), 10**30, -(2**63)),
    *("", "x", "../../x", "\x1b]0;title\x07", "<script>alert(1)</script>", "a\nb"),
    *("![t](http://127.0.0.1/x)", "x" * 100_000, [], {}, [[]], {"x": [None]}),
    *([1] * 1000, ["x", 1], {"x" * 300: 1}),
)
"""Values that are put in the place of others."""


def _changed_record(value: Any, rng: Rng) -> str:
    """Change a value somewhere in nested dictionaries and lists."""
    places = _places(value)
    if not places:
        return "nothing to change"
    container, key, where = _drawn(places, rng)
    way = rng.integers(4)
    if way == 0:
        del container[key]
        return f"{where} deleted"
    if way == 1 and isinstance(container, dict):
        container[f"{key}x"] = container.pop(key)
        return f"{where} renamed"
    if way == 2 and len(places) > 1:
        other, place, name = _drawn(places, rng)
        container[key] = deepcopy(other[place])
        return f"{where} replaced by {name}"
    new = _drawn(_VALUES, rng)
    container[key] = deepcopy(new)
    return f"{where} = {new!a:.40}"


def _places(value: Any, where: str = "", depth: int = 0) -> list[tuple[Any, Any, str]]:
    """Containers and keys of all values in a record, not too deep."""
    pairs: Any = ()
    if isinstance(value, dict):
        pairs = value.items()
    elif isinstance(value, list):
        pairs = list(enumerate(value))[:20]
    places = []
    for key, inner in pairs if depth < 6 else ():
        places.append((value, key, f"{where}/{key}"))
        places += _places(inner, f"{where}/{key}", depth + 1)
    return places


def _json(path: Path, rng: Rng) -> str:
    if rng.random() < 0.1:
        path.write_text("[" * 200_000 + "]" * 200_000, "utf-8")
        return "200,000 brackets"
    value = json.loads(path.read_text("utf-8"))
    about = _changed_record(value, rng)
    path.write_text(json.dumps(value), "utf-8")
    return about


def _jsonl(path: Path, rng: Rng) -> str:
    rows = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    about = _changed_record(rows, rng)
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), "utf-8")
    return about


# --- Arrays ------------------------------------------------------------------


def _hdf5(path: Path, rng: Rng) -> str:
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = _drawn(names, rng)
        way = _drawn(_HDF5_WAYS, rng)
        return f"{name}: {way(file, name, rng)}"


def _deleted(file: Any, name: str, rng: Rng) -> str:
    del file[name]
    return "deleted"


def _soft_link(file: Any, name: str, rng: Rng) -> str:
    del file[name]
    file[name] = h5py.SoftLink("/episode_0/rewards")
    return "a soft link"


def _external_link(file: Any, name: str, rng: Rng) -> str:
    del file[name]
    file[name] = h5py.ExternalLink(_ELSEWHERE, "/x")
    return "a link to another file"


def _external_storage(file: Any, name: str, rng: Rng) -> str:
    node = file[name]
    shape = node.shape if isinstance(node, h5py.Dataset) else (3,)
    size = 8 * int(np.prod(shape))
    del file[name]
    file.create_dataset(name, shape, "f8", external=[(_ELSEWHERE, 0, size)])
    return "stored in another file"


def _virtual(file: Any, name: str, rng: Rng) -> str:
    node = file[name]
    shape = node.shape if isinstance(node, h5py.Dataset) else (3,)
    del file[name]
    layout = h5py.VirtualLayout(shape, "f8")
    layout[...] = h5py.VirtualSource(_ELSEWHERE, "x", shape)
    file.create_virtual_dataset(name, layout)
    return "virtual"


def _huge(file: Any, name: str, rng: Rng) -> str:
    rows = int(10 ** rng.integers(7, 12))
    del file[name]
    file.create_dataset(name, (rows,), "f8", chunks=(10_000,), compression="gzip")
    return f"{rows} rows"


def _other_type(file: Any, name: str, rng: Rng) -> str:
    node = file[name]
    kinds: Sequence[Any] = ("f4", "i8", "bool", "S4", "c16", h5py.string_dtype())
    kind = _drawn(kinds, rng)
    shape = node.shape if isinstance(node, h5py.Dataset) else (3,)
    del file[name]
    file.create_dataset(name, shape, kind)
    return f"of type {kind}"


def _other_shape(file: Any, name: str, rng: Rng) -> str:
    shape = tuple(rng.integers(0, 5, size=rng.integers(0, 4)).tolist())
    del file[name]
    file.create_dataset(name, shape, "f8")
    return f"of shape {shape}"


def _other_value(file: Any, name: str, rng: Rng) -> str:
    node = file[name]
    numbers = isinstance(node, h5py.Dataset) and node.dtype.kind in "fiub"
    if not numbers or node.size == 0:
        return _other_shape(file, name, rng)
    value = _drawn((np.nan, np.inf, -1e30, 7.0, 0.0), rng)
    values = node[()]
    if values.dtype.kind != "f":
        value = 7
    values.flat[rng.integers(values.size)] = value
    node[()] = values
    return f"{value} somewhere"


def _attribute(file: Any, name: str, rng: Rng) -> str:
    node = file[name.split("/")[0]]
    keys = list(node.attrs)
    if not keys:
        return _deleted(file, name, rng)
    key = _drawn(keys, rng)
    values: Sequence[Any] = (-1, 2**63 - 1, 1.5, np.nan, "x", "\x1b[31m", np.zeros(3))
    if rng.random() < 0.2:
        del node.attrs[key]
        return f"attribute {key} deleted"
    value = _drawn(values, rng)
    node.attrs[key] = value
    return f"attribute {key} = {value!a:.40}"


_HDF5_WAYS: Sequence[Callable[[Any, str, Rng], str]] = (
    *(_deleted, _soft_link, _external_link, _external_storage, _virtual, _huge),
    *(_other_type, _other_shape, _other_value, _other_value, _attribute, _attribute),
)


def _checkpoint(path: Path, rng: Rng) -> str:
    contents = torch.load(path, weights_only=True)
    places = [p for p in _places(contents) if isinstance(p[0][p[1]], torch.Tensor)]
    if places and rng.random() < 0.5:
        container, key, where = _drawn(places, rng)
        tensor = container[key]
        changes: Sequence[tuple[str, Callable[[], torch.Tensor]]] = (
            ("NaN", lambda: torch.full_like(tensor.float(), torch.nan)),
            ("1e30", lambda: torch.full_like(tensor.float(), 1e30)),
            ("negated", lambda: -tensor.float()),
            ("doubles", tensor.double),
            ("flat", lambda: tensor.reshape(-1)),
            ("empty", lambda: torch.zeros(0, *tensor.shape)),
            ("repeated", lambda: torch.zeros(1).expand(10**12)),
            ("no rows", lambda: torch.zeros(10**9, 0)),
            ("sparse", tensor.float().to_sparse),
            ("whole numbers", lambda: torch.zeros(tensor.shape, dtype=torch.int64)),
        )
        name, change = _drawn(changes, rng)
        container[key] = change()
        about = f"{where}: {name}"
    else:
        about = _changed_record(contents, rng)
    with path.open("wb") as file:
        torch.save(contents, file)
    return about


def _archive(path: Path, rng: Rng) -> str:
    """Change a part of a zip archive, and its checksum."""
    with zipfile.ZipFile(path) as archive:
        parts = [(part.filename, archive.read(part)) for part in archive.infolist()]
    number = int(rng.integers(len(parts)))
    name, content = parts[number]
    way = int(rng.integers(4))
    if way == 0 and content:
        changed = bytearray(content)
        changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
        parts[number] = name, bytes(changed)
    elif way == 1:
        parts[number] = name, content[: len(content) // 2]
    elif way == 2:
        del parts[number]
    else:
        parts.append((name, content))
    kind = zipfile.ZIP_DEFLATED if rng.random() < 0.2 else zipfile.ZIP_STORED
    with zipfile.ZipFile(path, "w", kind) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # two parts of one name
        for part, data in parts:
            archive.writestr(part, data)
    return f"{name}: {('a bit', 'half', 'missing', 'twice')[way]}"


def _torch(path: Path, rng: Rng) -> str:
    of_values = path.suffix == Path(CHECKPOINT).suffix and rng.random() < 0.8
    return (_checkpoint if of_values else _archive)(path, rng)


def _safetensors(path: Path, rng: Rng) -> str:
    tensors = load_file(path)
    name = _drawn(sorted(tensors), rng)
    way = int(rng.integers(4))
    if way == 0:
        del tensors[name]
    elif way == 1:
        tensors[name] = torch.full_like(tensors[name], torch.nan)
    elif way == 2:
        tensors[name] = tensors[name].reshape(-1).clone()
    else:
        tensors[f"{name}x"] = tensors.pop(name)
    save_file(tensors, path)
    return f"{name}: {('deleted', 'NaN', 'flat', 'renamed')[way]}"


# --- Rows and journals -------------------------------------------------------


def _rows(path: Path, rng: Rng) -> str:
    openers: dict[str, Any] = {".xz": lzma.open, ".gz": gzip.open}
    opened = openers.get(path.suffix, open)
    with opened(path, "rt", newline="") as file:
        lines = [line for line in csv.reader(file) if line] or [[""]]
    line, way = int(rng.integers(len(lines))), int(rng.integers(5))
    column = int(rng.integers(len(lines[line])))
    if way == 0:
        lines[line].pop(column)
    elif way == 1:
        lines[line].append("1")
    elif way == 2:
        lines[line] = []
    else:
        values = ("", "nan", "x", "1e999", "\x1b[31m", "<b>", "9" * 5_000)
        lines[line][column] = _drawn(values, rng)
    text = io.StringIO(newline="")
    csv.writer(text).writerows(lines)
    with opened(path, "wt", newline="") as file:
        file.write(text.getvalue())
    return f"line {line}, column {column}: way {way}"


def _sqlite(path: Path, rng: Rng) -> str:
    with closing(sqlite3.connect(path)) as file, file:
        way = int(rng.integers(6))
        if way == 0:
            file.execute("drop table about")
        elif way == 1:
            file.execute("update about set text = ?", [float("nan")])
        elif way == 2:
            file.execute("update episodes set npz = 'text' where number = 0")
        elif way == 3:
            file.execute("drop table episodes")
            file.execute(
                "create view episodes as with recursive n(number, npz) as "
                "(select 0, 0 union all select number + 1, 0 from n) select * from n"
            )
        elif way == 4:
            blob = bytearray(file.execute("select npz from episodes").fetchone()[0])
            blob[int(rng.integers(len(blob)))] ^= 1 << int(rng.integers(8))
            file.execute("update episodes set npz = ?", [bytes(blob)])
        else:
            text = json.loads(file.execute("select text from about").fetchone()[0])
            about = _changed_record(text, rng)
            file.execute("update about set text = ?", [json.dumps(text)])
            return about
    return f"way {way}"


_INFORMED: dict[str, Change] = {
    ".json": _json,
    ".jsonl": _jsonl,
    Path(DATA).suffix: _hdf5,
    ".pt": _torch,
    ".ts": _torch,
    Path(WEIGHTS).suffix: _safetensors,
    ".csv": _rows,
    ".gz": _rows,
    ".xz": _rows,
    Path(JOURNAL).suffix: _sqlite,
}
"""Changes that know the format, by the suffix of files."""
