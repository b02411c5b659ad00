"""Compiled functions whose disk cache notices a change in any of their sources.

Numba's cache watches only the file of the function itself. A function that calls into
another file would silently go on with that file's old code. The cache folder is
therefore named after the contents of all sources of compiled code.
"""

import hashlib
import logging
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

P = ParamSpec("P")
R = TypeVar("R")

_SOURCES = (
    "jit.py",
    "control/*.py",
    "control/compiled/*.py",
    "robot/*.py",
    "sim/config.py",
    "sim/mujoco/native.py",
    "sim/planar.py",
    "envs/compiled.py",
    "envs/slosh.py",
)
"""Patterns of all sources of compiled code, relative to the package."""


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """``numba.njit`` with a cache on disk, keyed by all sources.

    The function may allocate no memory: without numba's counts of references, which
    are atomic, a tick takes 1 us less. Arrays come from the caller or ``on_stack``.
    It becomes a part of its compiled callers: passing records of arrays to it takes
    longer than the planar model itself.
    """
    previous = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = previous or str(_cache_folder())
    try:
        compiled: Callable[P, R] = numba.njit(
            cache=True, error_model="numpy", nogil=True, _nrt=False, forceinline=True
        )(function)
        return compiled
    finally:
        numba.config.CACHE_DIR = previous


def on_stack(
    *shape: int, number: types.Number = types.float64
) -> Callable[[], np.ndarray]:
    """Function that gives compiled code an array of numbers, not yet written.

    The array lies in the caller's frame, at the start of a cache line: it costs
    nothing, where ``np.empty`` costs 40 ns, and ends with the call. Each place in a
    function has one array, so that a loop gets the same one again.

    Args:
        shape: Shape of the array.
        number: Type of its numbers, of 8 bytes: float64 or int64.
    """
    kind, size = types.Array(number, len(shape), "C"), 8

    @intrinsic  # type: ignore[untyped-decorator]
    def allocate(typing: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            element = context.get_value_type(number)
            block = ir.ArrayType(element, int(np.prod(shape)))
            memory = cgutils.alloca_once(builder, block)
            memory.align = 64
            array = context.make_array(kind)(context, builder)
            populate_array(
                array,
                builder.bitcast(memory, array.data.type),
                [context.get_constant(types.intp, n) for n in shape],
                [
                    context.get_constant(types.intp, size * int(np.prod(shape[i:])))
                    for i in range(1, len(shape) + 1)
                ],
                context.get_constant(types.intp, size),
                None,
            )
            return array._getvalue()

        return kind(), generate

    function: Callable[[], np.ndarray] = allocate
    return function


@cache
def source_fingerprint() -> str:
    """Hash of all sources of compiled code and of numba's version, 16 hex digits."""
    package = Path(__file__).resolve().parent
    digest = hashlib.sha256(numba.__version__.encode())
    for pattern in _SOURCES:
        for path in sorted(package.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _cache_folder() -> Path:
    """The first folder that can be written, named after the sources' fingerprint."""
    package = Path(__file__).resolve().parent
    name = f"numba-{source_fingerprint()}"
    for parent in (package / "__pycache__", Path("~/.cache/marl_mm")):
        try:
            folder = parent.expanduser() / name
            new = not folder.exists()
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                if new:
                    logging.getLogger("marl_mm").warning(
                        "the first use compiles controller and model: half a minute"
                    )
                return folder
        except (OSError, RuntimeError):  # such as of a user without a home
            continue
    return Path(tempfile.mkdtemp(prefix="marl_mm-"))
