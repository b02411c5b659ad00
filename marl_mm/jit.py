"""Compiled functions whose disk cache notices a change in any of their sources.

Numba's cache watches only the file of the function itself. A function that calls into
another file would silently go on with that file's old code. The cache folder is
therefore named after the contents of all sources of compiled code.
"""

import hashlib
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import ParamSpec, TypeVar

import numba

P = ParamSpec("P")
R = TypeVar("R")

_SOURCES = (
    "jit.py",
    "control/*.py",
    "control/compiled/*.py",
    "robot/*.py",
    "sim/config.py",
    "sim/native.py",
    "sim/planar.py",
    "envs/compiled.py",
)
"""Patterns of all sources of compiled code, relative to the package."""


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """``numba.njit`` with a cache on disk, keyed by all sources."""
    previous = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = previous or str(_cache_folder())
    try:
        compiled: Callable[P, R] = numba.njit(
            cache=True, error_model="numpy", nogil=True
        )(function)
        return compiled
    finally:
        numba.config.CACHE_DIR = previous


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
    for parent in (package / "__pycache__", Path.home() / ".cache" / "marl_mm"):
        folder = parent / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return Path(tempfile.mkdtemp(prefix="marl_mm-"))
