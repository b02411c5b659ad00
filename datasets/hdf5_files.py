"""HDF5 files: opened once all in them was looked at, written by way of memory."""

import errno
import math
import os
import resource
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from marl_mm.errors import DatasetError, MarlMmError
from marl_mm.received import check_regular, most_unpacked, printable_name
from marl_mm.temporary import named_errors

_DAMAGE = (
    *(OSError, KeyError, ValueError, RuntimeError, TypeError, MemoryError),
    OverflowError,
)
"""Exceptions that h5py raises for damaged files."""

LONGEST_TEXT = 300
"""Largest length of a text [characters]."""

_DEPTH = 20
"""Largest number of groups around an array."""

_SMALL = 4_096
"""Size from which on compression gains more than its records take [bytes]."""

_PATIENCE = 30
"""Most processor time that reading a small file may take [s]."""

_SLOWEST = 200_000
"""Least speed of reading a large file [bytes/s]: a tenth of the usual speed."""

_OWN_MEMORY = 100_000_000
"""Memory of a process that reads beside libraries and arrays [bytes]."""


# --- Reading -----------------------------------------------------------------


def reading_limits(size: int) -> tuple[int, int]:
    """Most processor time [s] and memory [bytes] that reading a file may take.

    Args:
        size: Size of the file [bytes].
    """
    return _PATIENCE + size // _SLOWEST, _OWN_MEMORY + 4 * most_unpacked(size)


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    """Open an HDF5 file for reading, once all objects in it are looked at.

    Raises:
        DatasetError: If the file is damaged, or a part that the block reads. Also if
            an object lies elsewhere or has several names, or all arrays together are
            too large for the file.
    """
    size = check_regular(path, DatasetError)
    try:
        with h5py.File(path, "r") as file:
            _check_objects(path, file, most_unpacked(size))
            yield file
    except MarlMmError:
        raise
    except _DAMAGE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DatasetError(f"{path} is damaged ({reason:.160})") from error


def _check_objects(path: Path, file: Any, most: int) -> None:
    """Raise for a file whose objects are not all in it, each under one name.

    Args:
        path: The file, for messages.
        file: The open file.
        most: Largest size of all arrays together [bytes].

    Raises:
        DatasetError: Naming the object.
    """
    addresses = {h5py.h5o.get_info(file.id).addr}
    names: list[bytes] = []

    def fault(name: bytes, link: Any) -> str | None:
        """What is wrong with a link; HDF5 goes on for as long as it is None."""
        if link.type != h5py.h5l.TYPE_HARD:
            why = "is a link to another place, expected the object itself"
        elif link.u in addresses or name.count(b"/") >= _DEPTH:
            why = "is an object of several names, or in too many groups"
        else:
            addresses.add(link.u)
            names.append(name)
            return None
        return f"{_shown(name)} {why}"

    native = h5py.h5.ITER_NATIVE
    if (problem := file.id.links.visit(fault, order=native, info=True)) is not None:
        raise DatasetError(f"{path}, {problem}")
    size = 0
    for name in names:
        node = h5py.h5o.open(file.id, name)
        if not isinstance(node, h5py.h5d.DatasetID):
            continue
        how = node.get_create_plist()
        if how.get_layout() == h5py.h5d.VIRTUAL or how.get_external_count():
            raise DatasetError(
                f"{path}, {_shown(name)} is stored in other files, expected all data "
                "in this one"
            )
        size += math.prod(node.shape or ()) * node.get_type().get_size()
        if size > most:
            raise DatasetError(
                f"{path}, {_shown(name)} and others have {size:,} bytes, expected at "
                f"most {most:,} in a file of this size"
            )


def _shown(name: bytes) -> str:
    return printable_name(name[:LONGEST_TEXT].decode(errors="backslashreplace"))


# --- Writing -----------------------------------------------------------------


def write_tables(
    path: Path,
    tables: Mapping[str, np.ndarray],
    attributes: Mapping[str, Any],
    groups: Mapping[str, Mapping[str, Any]] | None = None,
) -> None:
    """Write arrays by key, large ones compressed, and attributes.

    Args:
        path: File to write.
        tables: Arrays by key, in which "/" divides the names of groups.
        attributes: Attributes of the file.
        groups: Attributes of groups, by key.

    Raises:
        OSError: If there is no room for the file; it names the file.
    """
    within = compact()

    def fill(file: Any) -> None:
        for key, values in tables.items():
            if values.nbytes < _SMALL:
                write_array(file, key, values, within)
            else:
                file.create_dataset(key, data=values, compression="gzip", shuffle=True)
        for name, of_group in {"/": attributes, **(groups or {})}.items():
            file[name].attrs.update(of_group)

    write_new(path, fill)


def write_new(path: Path, fill: Callable[[Any], None], **options: Any) -> None:
    """Write a new HDF5 file, which a function fills, by way of memory.

    On a full disk, HDF5 itself complains on stderr and may end the process. Its own
    files in memory have other bytes than those on a disk, so it writes one of the
    operating system's; the driver "stdio" does not mind that it has no path.

    Raises:
        OSError: If there is no room for the file; it names the file.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    if limit != resource.RLIM_INFINITY and _size(fill, options) > limit:
        # It holds in memory, too.
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    with os.fdopen(os.memfd_create("hdf5"), "r+b") as memory:
        name = f"/proc/self/fd/{memory.fileno()}"
        with h5py.File(name, "w", driver="stdio", **options) as file:
            fill(file)
        with named_errors(path), path.open("wb") as disk:
            shutil.copyfileobj(memory, disk)


def _size(fill: Callable[[Any], None], options: Mapping[str, Any]) -> int:
    """Size of a file before HDF5 cuts what it kept in reserve [bytes]."""
    nowhere = {"driver": "core", "backing_store": False}
    with h5py.File("hdf5", "w", **nowhere, **options) as file:
        fill(file)
        file.flush()
        return len(file.id.get_file_image())


def write_array(group: Any, name: str, values: np.ndarray, within: Any) -> None:
    """Write an array and the groups in its name.

    Args:
        group: Open group or file.
        name: Name within the group.
        values: The array.
        within: What ``compact`` returned; arrays that are too large for it lie outside.
    """
    values = np.asarray(values, order="C")
    large = values.nbytes >= 60_000  # the layout ends at 64 KiB
    kind = h5py.h5t.py_create(values.dtype, logical=True)
    space = h5py.h5s.create_simple(values.shape)
    properties, between = _without_times() if large else within, _with_groups()
    dataset = h5py.h5d.create(group.id, name.encode(), kind, space, properties, between)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, values)


def compact() -> Any:
    """Properties of an array that lies within the records about it."""
    properties = _without_times()
    properties.set_layout(h5py.h5d.COMPACT)
    return properties


@cache
def _with_groups() -> Any:
    """Properties of a link that make the groups in its name."""
    properties = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    properties.set_create_intermediate_group(True)
    return properties


def _without_times() -> Any:
    """Properties of an array that keep the time of writing out of the file."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)
    return properties
